import numpy as np
import pytest

from halfshaft import InputError, Vehicle
from halfshaft.studies.table import read_table

CAR = Vehicle.load("small-car-electric")


def test_numbers_are_read_in_si_or_in_their_unit(tmp_path):
    path = tmp_path / "cars.csv"
    path.write_text('body.m,"motor.P_max [kW]",body.c_d\n1000,50,0.3\n\n1200,75,0.25\n')
    found = read_table(path, CAR)
    assert list(found) == ["body.m", "motor.P_max", "body.c_d"]
    np.testing.assert_allclose(found["motor.P_max"], [50e3, 75e3], rtol=1e-12)
    np.testing.assert_array_equal(found["body.m"], [1000, 1200])


def test_all_that_is_wrong_is_said_at_once(tmp_path):
    path = tmp_path / "cars.csv"
    path.write_text("body.mm,body.m [kWh],body.c_d,body.c_d\n1,2,x,\n")
    with pytest.raises(InputError) as error:
        read_table(path, CAR)
    said = str(error.value)
    assert "body.mm is no number of the vehicle, did you mean" in said
    assert "kWh" in said
    assert "body.c_d stands 2 times" in said
    assert "vehicle 1: body.c_d = x, must be a number" in said
    assert "vehicle 1: body.c_d = nothing, must be a number" in said


@pytest.mark.parametrize("text", ["", "body.m\n"])
def test_a_table_without_vehicles_is_refused(text, tmp_path):
    path = tmp_path / "cars.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="a line for each vehicle"):
        read_table(path, CAR)


def test_a_line_of_another_length_is_refused(tmp_path):
    path = tmp_path / "cars.csv"
    path.write_text("body.m,body.c_d\n1000,0.3\n1000\n")
    with pytest.raises(InputError, match="vehicle 2 has 1 entries, there are 2 titles"):
        read_table(path, CAR)
