"""The made-up epoch goes all the way: were it refused on the way, half of the engine would stay uncompiled."""

from camber.gnss.warm_up import warm_up


def test_the_made_up_epoch_is_fixed_with_integers_that_go_on():
    solution = warm_up()
    assert solution.quality == "fixed"
    assert solution.continuity == "continuous"
