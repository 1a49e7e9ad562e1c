"""The `hyperbit` command as `python -m hyperbit`."""

from hyperbit.controller.cli import main

if __name__ == "__main__":
    main()
