"""Communication with boards outside the executor: `check --bus`, `probe`, `node-id`, EDS."""
