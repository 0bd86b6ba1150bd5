from halfshaft.app.figures import figure_rows


def test_what_a_vehicle_does_not_use_is_left_out_and_what_it_did_not_reach_is_not():
    figures = {"time_0_to_60_mph_s": None, "combined_energy_kWh_per_100km": None, "combined_energy_MPGe": 45.829, "city_distance_m": 12e3}
    assert figure_rows(figures, "metric") == [
        ("time 0 to 60 mph", "-"),
        ("combined energy", "45.829 MPGe"),
        ("city distance", "12.000 km"),
    ]
