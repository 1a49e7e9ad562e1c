"""The running master: boards, outputs, commits, supervision."""
