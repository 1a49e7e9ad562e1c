"""Why was my goal refused? All reasons: the name in payloads, the sentence, the advice, and the code.

A sentence names its facts in braces. The advice says what to do, and may name the `{arm}`; an empty one means that the
sentence says what would be right.
"""

import enum

from hyperbit.controller.refusals.codes import GOAL_TOLERANCE_VIOLATED, INVALID_GOAL, OLD_HEADER_TIMESTAMP

REPORT = "report this defect of hyperbit with the journal: journalctl -u 'hyperbit*'"
RESET = "remove the cause, then: hyperbit reset {arm}"
AGAIN = "send it again"
FEWER = "send fewer waypoints"
CLOCK = "set the clocks of both computers by NTP"
OBSTACLES = "move the goal or the obstacle"
JOG = "switch single actuators: hyperbit jog {arm} ACTUATOR=STATE"


@enum.unique
class Reason(enum.Enum):
    """Why a request is refused; the value is the field `reason` of payloads.

    Attributes:
        sentence: a template that the facts of a refusal fill.
        advice: what to do; may be empty.
        code: of FollowJointTrajectory.
    """

    _value_: str
    sentence: str
    advice: str
    code: int

    def __new__(cls, value: str, sentence: str, advice: str = "", code: int = INVALID_GOAL) -> "Reason":
        reason = object.__new__(cls)
        reason._value_, reason.sentence, reason.advice, reason.code = value, sentence, advice, code
        return reason

    # --- payloads: controller/motion/decoding

    TOO_LARGE = "too-large", "{what} of {size} bytes, at most {most} are accepted"
    NOT_UTF8 = "not-utf8", "{what} is not UTF-8: byte {byte} is 0x{value}"
    NOT_JSON = "not-json", "{what} is not JSON: {error}"
    NOT_UNICODE = "not-unicode", "{what}: a text in it is no Unicode"
    NESTED_TOO_DEEPLY = "nested-too-deeply", "{what} is nested too deeply"
    NO_OBJECT = "no-object", "{what}: an object with {fields} is needed"
    INVALID_FIELDS = "invalid-fields", "{faults}"
    UNKNOWN_ACTUATOR = "unknown-actuator", "{field}: {actuator} is no actuator of this arm; {known}"
    WRONG_DIMENSION = "wrong-dimension", "{where}: {count} coordinates, this arm's positions have {dimension}"

    # --- waypoints: controller/motion/decoding

    NO_WAYPOINTS = "no-waypoints", "waypoints: empty; at least one is needed"
    TOO_MANY_WAYPOINTS = "too-many-waypoints", "waypoints: {count}, at most {most} are accepted"
    NO_DESTINATION = "no-destination", "{where}: required, but missing; a `configuration` may replace it"
    TWO_DESTINATIONS = "two-destinations", "{where}: a configuration already determines it, leave out one of them"
    POSITIONS_ONLY = "positions-only", "{where}: only positions are accepted here"
    LINE_WITH_POSE = "line-with-pose", "{where}: lines are followed by position only, leave out path_tolerance"
    NO_CONFIGURATION = "no-configuration", "{where}: {error}"
    NO_ANGLE = "no-angle", "{where}: a planar arm's orientation is an angle in radians, got {count} numbers"
    NO_QUATERNION = "no-quaternion", "{where}: a quaternion x, y, z, w of length 1 is needed, got {got}"

    # --- times: controller/motion

    TIMES_NOT_INCREASING = (
        "times-not-increasing",
        "{where}: {t} does not come after {earlier}",
        "give each waypoint a time `t` in seconds, later than the one before",
    )
    TIMES_TOO_CLOSE = "times-too-close", "{where}: {apart} s apart, the actuators need {needed} s"
    ARRIVED_TOO_LATE = (
        "arrived-too-late",
        "stamp: the trajectory ended {late} s before it arrived",
        CLOCK,
        OLD_HEADER_TIMESTAMP,
    )
    PLANNED_TOO_LATE = (
        "planned-too-late",
        "stamp: the trajectory ended {late} s before it was planned",
        "give it a later stamp, or none",
        OLD_HEADER_TIMESTAMP,
    )
    TOO_FAR_AHEAD = (
        "too-far-ahead",
        "stamp: the trajectory would end {ahead} s from now, at most {most} s are accepted; stamps are UNIX seconds",
    )
    STALE = "stale", "stamp: {age} s old on arrival, at most {most} s are accepted", CLOCK, OLD_HEADER_TIMESTAMP
    FROM_THE_FUTURE = (
        "from-the-future",
        "stamp: {ahead} s in the future, at most {most} s are accepted; stamps are UNIX seconds",
        CLOCK,
    )
    OUT_OF_ORDER = (
        "out-of-order",
        "stamp: {early} s before the last accepted one",
        "send samples in the order of their stamps",
        OLD_HEADER_TIMESTAMP,
    )
    TOO_MANY_POINTS = (
        "too-many-points",
        "path_tolerance: {tolerance} takes {count} points along lines of {length} in all, at most {most} are accepted;"
        " {enough} would do",
    )
    LINE_TOO_FAST = (
        "line-too-fast",
        "{where}: {seconds} s for a line of {length} within path_tolerance {tolerance}, the actuators need {needed} s",
    )
    TIME_TOO_SHORT = "time-too-short", "{where}: {available} s, {needed}"

    # --- set-points and measured tips: controller/motion/tracking, controller/planning/core/stream.py

    NO_ORIENTATION = "no-orientation", "tolerance.orientation: this arm follows positions only, leave it out"
    OTHER_ORIENTATION = "other-orientation", "orientation: {wanted} is needed for this arm"
    NOT_FINITE = "not-finite", "{where}: {given} given, {needed} are needed"
    STREAM_OF_ANOTHER = (
        "stream-of-another",
        "a set-point of {sender}: {owner} streams set-points already, until it pauses for {pause} s",
        "end the other stream; attach a name to your set-points, so that streams are told apart",
    )
    TIP_TOO_FAR = (
        "tip-too-far",
        "position: {away} from the computed tip, at most {most} is accepted, twice the clamp",
        "check the frame of the tracker, and calibrate the arm: hyperbit calibrate",
    )
    TIP_NOT_KNOWN = "tip-not-known", "the arm is {mode}, or its configuration is not known"
    TIP_MOVING = "tip-moving", "stamp: the arm was moving, or not yet settled"

    # --- the search of a plan: controller/motion/plans, controller/planning/workers

    BEYOND_LENGTH = (
        "beyond-length",
        "{where}: ({position}) is out of reach: {away} from the base, and no tip is farther from it than {farthest}",
        "see where the arm can reach: hyperbit workspace ARM.yaml",
        GOAL_TOLERANCE_VIOLATED,
    )
    OUT_OF_REACH = (
        "out-of-reach",
        "{where}: ({position}) is out of reach{turned}; {nearest}",
        "see where the arm can reach: hyperbit workspace ARM.yaml",
        GOAL_TOLERANCE_VIOLATED,
    )
    NOT_FOUND = (
        "not-found",
        "{where}: ({position}) seems out of reach{turned}; {nearest}",
        "send it again, or see where the arm can reach: hyperbit workspace ARM.yaml",
        GOAL_TOLERANCE_VIOLATED,
    )
    LOCKED_CONFIGURATION = (
        "locked-configuration",
        "{where}: a locked actuator: {error}",
        "send another configuration, or unlock the actuator: hyperbit lock {arm} ACTUATOR=free",
        GOAL_TOLERANCE_VIOLATED,
    )
    ONLY_BY_COLLISION = (
        "only-by-collision",
        "{where}: ({position}) {reach}{turned}; {nearest}",
        OBSTACLES,
        GOAL_TOLERANCE_VIOLATED,
    )
    GOAL_IN_OBSTACLE = "goal-in-obstacle", "{where}: {collision}", OBSTACLES, GOAL_TOLERANCE_VIOLATED
    NO_CLEAR_PATH = (
        "no-clear-path",
        "{where}: no collision-free transition to it was found: {blocked}",
        OBSTACLES,
        GOAL_TOLERANCE_VIOLATED,
    )
    NO_WAY = (
        "no-way",
        "{where}: there is no collision-free transition to it, {proof}: {blocked}",
        OBSTACLES,
        GOAL_TOLERANCE_VIOLATED,
    )
    PLAN_COLLIDES = "plan-collides", "the plan would collide: {collision}", OBSTACLES, GOAL_TOLERANCE_VIOLATED
    START_COLLIDES = (
        "start-collides",
        "the motion from the arm's present state would collide: {collision}",
        "jog single actuators away from the obstacle, or remove one that was sent: hyperbit obstacles {arm} --none",
    )
    ARM_IN_OBSTACLE = (
        "arm-in-obstacle",
        "the arm may not move from where it stands: {collision}",
        "remove the obstacle; one that was sent: hyperbit obstacles {arm} --none",
    )
    UNKNOWN_STATE = "unknown-state", "unknown state: {why}; switch single actuators with `jog`", JOG
    STATE_IN_BETWEEN = (
        "state-in-between",
        "unknown state: the arm moves to states that are no configuration ({why}); send another `jog`",
        JOG,
    )
    LOCKS_CHANGING = "locks-changing", "the locked actuators are changing, send it again", AGAIN
    TOO_MANY_STAGES = (
        "too-many-stages",
        "the plan has {total} stages, {longest} to one point; at most {most} and {most_to_one} are accepted",
        FEWER,
    )
    PLANNING_TOO_LONG = "planning-too-long", "planning took longer than {seconds} s", FEWER
    PLAN_CANCELED = "plan-canceled", "the plan was canceled", "send it again, if it is still needed"

    # --- the way of a request: controller/gateway, controller/planning/core

    NOT_NAMED = "not-named", "{key} must be named, as in {name}; {given} does not name it"
    NOT_EXPLAINED = (
        "not-explained",
        "the request is malformed; no details are given while many bad requests arrive",
        "send one request a second, then the answer says what is wrong",
    )
    UNKNOWN_GOAL = "unknown-goal", "the ledger has no goal {goal}: it was not accepted, or is not written yet"
    LEDGER_UNREADABLE = (
        "ledger-unreadable",
        "the ledger cannot be read: {why}",
        "see its warnings: hyperbit watch {arm}",
    )
    UNKNOWN_POSE = "unknown-pose", "remove: there is no saved pose {name}; saved are {known}"
    TOO_MANY_POSES = "too-many-poses", "save: an arm has at most {most} saved poses", "remove one: hyperbit poses {arm}"
    POSES_UNWRITTEN = (
        "poses-unwritten",
        "the saved poses cannot be changed: {why}",
        "free or mend the disk",
    )
    BUSY = "busy", "busy: {most} {what} are waiting already", "wait for the answers"
    INTERNAL_ERROR = "internal-error", "internal error, see the journal", REPORT
    PLANNING_FAILED = "planning-failed", "internal error while planning, see the journal", REPORT
    SHUTTING_DOWN = "shutting-down", "the daemon is shutting down", "send it again to the next daemon"
    COMMISSIONING = (
        "commissioning",
        "the arm is being commissioned, and accepts no {key} until this has ended",
        "answer the questions of the commission, or leave it by q",
    )
    QUESTION_NOT_OPEN = (
        "question-not-open",
        "nothing is done: the question is not open, {why}",
        "read the present question",
    )
    NO_ANSWER = "no-answer", "{given} is no answer: {known}"
    ANSWER_TOO_LATE = (
        "answer-too-late",
        "nothing is done: the answer belongs to a state {age} s ago, at most {most} s are accepted",
        "look at the arm, then answer again",
    )
    ALREADY_RUNNING = "already-running", "id: goal {goal} is running already; a goal that replaces it needs another id"
    ACTUATOR_LOCKED = (
        "actuator-locked",
        "actuators: {actuator} is locked: unlock it with `degrade` first",
        "unlock it: hyperbit lock {arm} ACTUATOR=free",
    )
    OVERTAKEN = (
        "overtaken",
        "a cancel, stop, reset or fault, or the loss of the planner, came before it began",
        AGAIN,
    )
    TOO_LATE_TO_BEGIN = (
        "too-late-to-begin",
        "the motion could not begin within its `begin_within`: other requests or its own search took too long",
        "send it again, if it is still wanted; `begin_within` gives it more time",
    )
    OBSTACLES_CHANGING = "obstacles-changing", "the obstacles changed each time before the goal could begin", AGAIN
    ARM_MOVED = "arm-moved", "the arm moved each time before the goal could begin", AGAIN
    ARM_STARTING = "arm-starting", "the arm is starting: {why}", "wait until it is ready: hyperbit watch {arm}"
    ARM_IN_FAULT = "arm-in-fault", "the arm is in fault: {why}", RESET
    ARM_STOPPED = "arm-stopped", "the arm is stopped: {why}", "leave the stop by: hyperbit reset {arm}"
    ARM_NOT_KNOWN = "arm-not-known", "the arm is {mode}, and a state is not known: {why}", AGAIN
    NO_EXECUTOR = (
        "no-executor",
        "the executor is not connected: {why}",
        "check it by: systemctl status 'hyperbit-executor@*'",
    )
    EXECUTOR_LOST = (
        "executor-lost",
        "the connection to the executor was lost before it answered: {why}",
        "check it by: systemctl status 'hyperbit-executor@*'",
    )
    EXECUTOR_SILENT = "executor-silent", "the executor did not answer within {seconds} s", AGAIN
    EXECUTOR_BEHIND = "executor-behind", "the executor has not answered an earlier request", AGAIN
    OBSTACLES_NOT_CHECKED = (
        "obstacles-not-checked",
        "the obstacles cannot be checked, see the journal; those before stay in force",
        REPORT,
    )
    MODULE_WITHOUT_STATE = "module-without-state", "state: {error}", "lock another state, or unlock other actuators"

    # --- the executor: controller/executor/core/requests.py

    EXECUTOR_SHUTTING_DOWN = "executor-shutting-down", "the executor is shutting down", "wait for the next executor"
    MOVED_SINCE_PLANNED = "moved-since-planned", "the arm has moved since the program was planned", AGAIN
    SWITCH_NOT_CONFIRMED = "switch-not-confirmed", "the boards have not confirmed the last switch yet", AGAIN
    PROGRAM_LOCKED = "program-locked", "{misfit}", AGAIN
    PROGRAM_MALFORMED = "program-malformed", "{misfit}", REPORT
    NO_SUCH_ACTUATOR = "no-such-actuator", "the arm has {count} actuators, there is none of index {index}"
    END_STOP_CONTRADICTS = (
        "end-stop-contradicts",
        "state: the end-stop of {actuator} reads {state}",
        "lock it in this state, or repair the end-stop",
    )
    LOCK_WHILE_MOVING = (
        "lock-while-moving",
        "the arm is {mode}, and may not move while locks change",
        "cancel, then try again: hyperbit cancel {arm}",
    )
    NOT_SIMULATED = (
        "not-simulated",
        "the boards of this arm are real; faults are played in simulated boards only",
        "start a simulated arm by: hyperbit run ARM.yaml --simulate",
    )
    NO_SUCH_FAULT = "no-such-fault", "{why}", "see all faults: hyperbit fault --help"
    INTERLOCK_OPEN = "interlock-open", "{interlock}", "close the interlock, then: hyperbit reset {arm}"


def advice(reason: object, arm: str) -> str:
    """Returns the advice for the field `reason` of a payload; "" if there is none, as of a newer daemon's reason."""
    known = {each.value: each for each in Reason}.get(reason if isinstance(reason, str) else "")
    return "" if known is None else known.advice.replace("{arm}", arm)
