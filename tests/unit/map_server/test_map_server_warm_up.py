from camber.map_server.warm_up import warm_up


def test_it_returns_the_synthetic_road_with_a_patch() -> None:
    road = warm_up()
    assert (road.status, road.elevation_m) == ("known", 50.0)
    assert road.patch is not None
