"""One script of events for two action servers, that of the wire and that of rclpy: what a client must see of each.

This file imports nothing, because it runs in the Python of ROS as well.
"""

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
UNKNOWN, EXECUTING, CANCELING = 0, 2, 3
NONE, REJECTED, UNKNOWN_GOAL, TERMINATED = range(4)  # codes of a cancel
REJECTED_ORDER, UNCANCELABLE_ORDER = 0, 2  # goals that the server rejects, and whose cancel it rejects
ALL = [0] * 16


def script(side):
    """Returns lists of what is seen: its title, what a client of this side sees, and what is expected.

    `side` has send_goal(uuid, order), ask_result(uuid) -> function that waits, cancel(uuid, sec), end(uuid, how,
    sequence), feedback(uuid, sequence) -> what was received, and until(uuid, status) -> all states, once one is so.
    """
    seen = []
    a, b, c, d, e, f, g, h, i, unknown = ([number] * 16 for number in range(1, 11))

    def note(what, found, expected):
        seen.append([what, found, expected])

    def execute(*goals, order=1):
        for goal in goals:
            side.send_goal(goal, order)
            side.until(goal, EXECUTING)

    note("accept", side.send_goal(a, 1), True)
    note("executing", side.until(a, EXECUTING), [[1, EXECUTING]])
    note("feedback", side.feedback(a, [1, 2]), [1, [1, 2]])
    result = side.ask_result(a)
    side.end(a, SUCCEEDED, [1, 2, 3])
    note("result that was asked for before the end", result(), [SUCCEEDED, [1, 2, 3]])
    note("succeeded", side.until(a, SUCCEEDED), [[1, SUCCEEDED]])
    note("result that was asked for after the end", side.ask_result(a)(), [SUCCEEDED, [1, 2, 3]])
    note("known goal", side.send_goal(a, 1), False)
    note("result of an unknown goal", side.ask_result(unknown)(), [UNKNOWN, []])
    note("cancel of an unknown goal", side.cancel(unknown, 0), [UNKNOWN_GOAL, []])
    note("cancel of an ended goal", side.cancel(a, 0), [TERMINATED, []])

    note("accept another", side.send_goal(b, 1), True)
    side.until(b, EXECUTING)
    note("cancel", side.cancel(b, 0), [NONE, [2]])
    note("canceling", side.until(b, CANCELING), [[1, SUCCEEDED], [2, CANCELING]])
    note("cancel again", side.cancel(b, 0), [TERMINATED, []])
    side.end(b, CANCELED, [7])
    note("canceled", side.ask_result(b)(), [CANCELED, [7]])
    note("canceled state", side.until(b, CANCELED), [[1, SUCCEEDED], [2, CANCELED]])

    execute(c)
    side.end(c, ABORTED, [])
    note("aborted", side.ask_result(c)(), [ABORTED, []])

    execute(d, e)
    note("cancel of those until 1970", side.cancel(ALL, 1), [NONE, []])
    note("cancel of all", side.cancel(ALL, 0), [NONE, [4, 5]])
    side.until(d, CANCELING)
    side.until(e, CANCELING)
    side.end(d, CANCELED, [])
    side.end(e, SUCCEEDED, [5])
    note("canceled with others", side.ask_result(d)(), [CANCELED, []])
    note("succeeded though canceling", side.ask_result(e)(), [SUCCEEDED, [5]])

    note("reject", side.send_goal(f, REJECTED_ORDER), False)
    note("result of a rejected goal", side.ask_result(f)(), [UNKNOWN, []])

    execute(g, order=UNCANCELABLE_ORDER)
    note("rejected cancel", side.cancel(g, 0), [REJECTED, []])
    side.end(g, SUCCEEDED, [])
    note("goal goes on", side.ask_result(g)(), [SUCCEEDED, []])

    execute(h, i)
    note("cancel of one and those until 1970", side.cancel(h, 1), [NONE, [8]])
    note("cancel of those until 2100", side.cancel(ALL, 2**31 - 1), [NONE, [9]])
    for goal in (h, i):
        side.until(goal, CANCELING)
        side.end(goal, ABORTED, [])
        note("aborted though canceling", side.ask_result(goal)(), [ABORTED, []])
    note("cancel of nothing", side.cancel(ALL, 0), [NONE, []])
    return seen
