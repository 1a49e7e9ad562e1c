"""The operator's page: a web server that shows arms, and a Zenoh client beside the planner. An extra of the package."""
