"""What pages show of an arm whose state is partly unknown."""

from tests.panel.conftest import Site


def test_the_last_known_pose_is_drawn_in_a_fault(site: Site) -> None:
    page = site.open()
    site.daemon.state(commanded=[1] * 48, measured=[1] * 48)
    known = page.until("bodies")
    assert known["unknown"] == []
    partly = [None] * 3 + [1] * 42 + [None] * 3
    site.daemon.state(mode="fault", commanded=None, measured=partly, configuration=None, tip=None)
    fault = page.until("bodies", lambda told: told["unknown"])
    assert fault["unknown"] == [0, 15]
    assert fault["measured"] == known["measured"]
    assert fault["commanded"] is None
    assert fault["last"] == [1] * 48
    site.daemon.state(mode="unknown", commanded=None, measured=[None] * 48, configuration=None, tip=None)
    lost = page.until("bodies", lambda told: len(told["unknown"]) == 16)
    assert lost["measured"] == known["measured"]


def test_unknown_actuators_are_guessed_from_what_is_known_of_their_module(site: Site) -> None:
    page = site.open()
    site.daemon.state(mode="fault", commanded=None, measured=[None, *[0] * 47], configuration=None, tip=None)
    partly = page.until("bodies", lambda told: told["unknown"] == [0])
    assert partly["last"][0] is None
    site.daemon.state()
    assert page.until("bodies", lambda told: told["unknown"] == [])["measured"] == partly["measured"]


def test_poses_that_another_client_saves_are_shown_at_once(site: Site) -> None:
    site.daemon.told["poses"] = [{"name": "home", "goal": {}}]
    page = site.open()
    site.daemon.state(poses=0)
    page.until("arm", lambda told: told["poses"])
    site.daemon.told["poses"] = [{"name": "home", "goal": {}}, {"name": "pick", "goal": {}}]
    site.daemon.state(poses=1)
    page.until("arm", lambda told: [pose["name"] for pose in told["poses"]] == ["home", "pick"])
