"""The operator's web page: a web server and Zenoh client beside the planner. It needs the extra `panel`."""
