"""The `hyperbit` command. Exit codes: 0 done, 1 the thing asked for failed, 2 unusable input."""

import sys

import typer

from controller.commands import calibrate, demo, health, plan, report, service, talk, tell
from controller.commands.common import Failed, errors
from controller.strict import InputFaults

app = typer.Typer(
    name="hyperbit",
    help="Drives arms made of many two-state actuators: goals over Zenoh in, switch commands over CANopen out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(service.run)
app.command()(service.simulate)
app.command()(demo.demo)
app.command()(talk.send)
app.command()(talk.watch)
app.command()(tell.cancel)
app.command()(tell.stop)
app.command()(tell.reset)
app.command()(tell.degrade)
app.command()(tell.obstacles)
app.command()(plan.plan)
app.command()(report.fk)
app.command("map")(report.map_)
app.command()(report.figure5)
app.command()(health.check)
app.command()(health.wear)
app.command()(calibrate.calibrate)


def main() -> None:
    """Runs the command line, with words and an exit code in place of tracebacks for what a user can mend."""
    try:
        app()
    except InputFaults as error:
        errors.print(str(error), markup=False)
        sys.exit(2)
    except Failed as error:
        errors.print(str(error), markup=False)
        sys.exit(1)


if __name__ == "__main__":
    main()
