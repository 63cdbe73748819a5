from camber.map_server.warm_up import warm_up


def test_a_made_up_road_is_found_with_what_is_around_it() -> None:
    found = warm_up()
    assert (found.status, found.elevation_m) == ("known", 50.0)
    assert found.patch is not None
