import time

from huepose.support.stages import listening, stage


def test_stages_are_summed_by_name_in_order():
    with listening() as clock:
        for _ in range(3):
            with stage("sleep"):
                time.sleep(0.01)
            with stage("work"):
                sum(range(100_000))
    totals = clock.totals()
    assert list(totals) == ["sleep", "work"]
    wall, cpu = totals["sleep"]
    assert 0.03 <= wall < 1.0
    assert cpu < 0.5 * wall
    assert totals["work"][1] > 0


def test_without_a_listener_nothing_is_recorded():
    with stage("unheard"):
        pass
    with listening() as clock:
        pass
    assert clock.totals() == {}
