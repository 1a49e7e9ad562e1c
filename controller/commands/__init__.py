"""The commands, in rooms by the groups of `hyperbit --help`; `table.py` names them all."""

ENDPOINT = "tcp/127.0.0.1:7447"  # of the daemon, unless --connect or the variable CONNECT names another one
CONNECT = "HYPERBIT_CONNECT"
