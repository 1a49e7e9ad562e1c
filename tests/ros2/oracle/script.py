"""One script of events for two action servers, that of the wire and that of rclpy. Both run it, and note what they see.

This file imports nothing, because it runs in the Python of ROS as well.
"""

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
EXECUTING, CANCELING = 2, 3
REJECTED_ORDER, UNCANCELABLE_ORDER = 0, 2  # goals that the server rejects, and whose cancel it rejects


def uuid(number):
    return [number] * 16


def script(side):
    """Returns what a client sees, as JSON.

    `side` has send_goal(uuid, order), ask_result(uuid) -> function that waits, cancel(uuid, sec), end(uuid, how,
    sequence), feedback(uuid, sequence) -> what was received, and until(uuid, status) -> all states, once one is so.
    """
    seen = []
    a, b, c, d, e, f, g, h, i, unknown = (uuid(number) for number in range(1, 11))

    def note(what, value):
        seen.append([what, value])

    note("accept", side.send_goal(a, 1))
    note("executing", side.until(a, EXECUTING))
    note("feedback", side.feedback(a, [1, 2]))
    result = side.ask_result(a)
    side.end(a, SUCCEEDED, [1, 2, 3])
    note("result that was asked for before the end", result())
    note("succeeded", side.until(a, SUCCEEDED))
    note("result that was asked for after the end", side.ask_result(a)())
    note("known goal", side.send_goal(a, 1))
    note("result of an unknown goal", side.ask_result(unknown)())
    note("cancel of an unknown goal", side.cancel(unknown, 0))
    note("cancel of an ended goal", side.cancel(a, 0))

    note("accept another", side.send_goal(b, 1))
    side.until(b, EXECUTING)
    note("cancel", side.cancel(b, 0))
    note("canceling", side.until(b, CANCELING))
    note("cancel again", side.cancel(b, 0))
    side.end(b, CANCELED, [7])
    note("canceled", side.ask_result(b)())
    note("canceled state", side.until(b, CANCELED))

    side.send_goal(c, 1)
    side.until(c, EXECUTING)
    side.end(c, ABORTED, [])
    note("aborted", side.ask_result(c)())

    for goal in (d, e):
        side.send_goal(goal, 1)
        side.until(goal, EXECUTING)
    note("cancel of those until 1970", side.cancel(uuid(0), 1))
    note("cancel of all", side.cancel(uuid(0), 0))
    side.until(d, CANCELING)
    side.until(e, CANCELING)
    side.end(d, CANCELED, [])
    side.end(e, SUCCEEDED, [5])
    note("canceled with others", side.ask_result(d)())
    note("succeeded though canceling", side.ask_result(e)())

    note("reject", side.send_goal(f, REJECTED_ORDER))
    note("result of a rejected goal", side.ask_result(f)())

    side.send_goal(g, UNCANCELABLE_ORDER)
    side.until(g, EXECUTING)
    note("rejected cancel", side.cancel(g, 0))
    side.end(g, SUCCEEDED, [])
    note("goal goes on", side.ask_result(g)())

    for goal in (h, i):
        side.send_goal(goal, 1)
        side.until(goal, EXECUTING)
    note("cancel of one and those until 1970", side.cancel(h, 1))
    note("cancel of those until 2100", side.cancel(uuid(0), 2**31 - 1))
    for goal in (h, i):
        side.until(goal, CANCELING)
        side.end(goal, ABORTED, [])
        note("aborted though canceling", side.ask_result(goal)())
    note("cancel of nothing", side.cancel(uuid(0), 0))
    return seen
