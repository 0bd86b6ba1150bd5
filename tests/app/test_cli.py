import json
import os
import shlex
import signal
import stat
import subprocess
import sys
import time
from functools import partial

import pytest
from typer.testing import CliRunner

import halfshaft
from halfshaft.app.cli import app
from halfshaft.cosim import simulate

KEYS = {
    "distance_m", "duration_s", "fuel_L", "fuel_economy_L_per_100km", "motor_input_J", "soc_start", "soc_end",
    "trace_miss_max_mps", "balance_relative", "warnings", "account",
}  # fmt: skip
RUN = ("run", "small-car-electric", "--cycle", "us06")


@pytest.fixture(autouse=True, scope="module")
def width():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "100")
        yield


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def done(*arguments):
    result = call(*arguments)
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    return result.stdout


def refused(*arguments):
    """Return the message of a call that must end with exit code 2."""
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert "Traceback" not in result.stderr
    return result.stderr


@pytest.mark.parametrize("car", ["small-car-electric", "small-car-series", "small-car-conventional"])
def test_json_holds_the_summary_and_the_account(car):
    found = json.loads(done("run", car, "--cycle", "us06", "--json"))
    assert found.keys() >= KEYS
    assert found["duration_s"] == 600
    assert abs(found["balance_relative"]) < 1e-9
    assert (found["fuel_L"] is None) == (car == "small-car-electric")
    assert (found["soc_end"] is None) == (car == "small-car-conventional")
    a = found["account"]
    method = a["speed_mismatch_J"] + a["inertia_discretisation_J"] + a["speed_limit_J"]
    left = a["fuel_J"] + a["battery_J"] - sum(a["losses_J"].values()) - a["kinetic_J"] - a["potential_J"] - method
    # The same sum, in another order.
    assert left == pytest.approx(a["residual_J"], abs=1e-6)
    assert sum(part["loss_J"] for part in a["parts"].values()) == pytest.approx(sum(a["losses_J"].values()))


def test_a_run_is_shown_as_a_table():
    text = done("run", "small-car-series", "--cycle", "us06")
    for expected in (
        "12.887 km",
        "L/100 km",
        "kWh",
        "0.7000 -> ",
        "engine",
        "speed mismatch: slower than asked",
        "balance",
        "battery limit",
    ):
        assert expected in text


def test_numbers_are_set_with_units_and_in_si():
    by_mass = done(*RUN, "--mass", "1500", "--soc", "0.9", "--json")
    assert by_mass == done(*RUN, "--set", "body.m=1.5 t", "--set", "battery.soc_start=90 %", "--json")
    assert by_mass == done(*RUN, "--set", "body.m=1500", "--set", "battery.soc_start=0.9", "--json")
    assert json.loads(by_mass)["soc_start"] == 0.9


def test_modes_and_ways_of_running():
    refined = json.loads(done(*RUN, "--mode", "refined", "--json"))
    assert refined["mode"] == "refined"
    by_step, by_fmu = (json.loads(done(*RUN, "--via", via, "--json")) for via in ("step", "fmu3"))
    assert by_fmu.pop("via") == "fmu3"
    assert by_step.pop("via") == "step"
    assert by_fmu["soc_end"] == pytest.approx(by_step["soc_end"], rel=1e-12)


def test_forward_facing(tmp_path):
    trip = tmp_path / "trip.csv"
    trip.write_text("time_s,speed_kmh\n0,0\n10,36\n30,36\n")
    found = json.loads(done("run", "small-car-electric", "--cycle", trip, "--via", "forward", "--json"))
    assert found["via"] == "forward"
    assert found["distance_m"] == pytest.approx(250, rel=0.01)


def test_files_are_written(tmp_path):
    text = done(*RUN, "--out", tmp_path / "run.nc", "--plot", tmp_path / "run.png")
    assert "run.nc" in text
    assert halfshaft.Result.load(tmp_path / "run.nc").summary["distance_m"] > 12000
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("run", "smal-car-electric", "--cycle", "us06"),
            "vehicle 'smal-car-electric': not in the library, did you mean 'small-car-electric'?",
        ),
        (("run", "missing.toml", "--cycle", "us06"), "missing.toml: cannot be read: No such file or directory"),
        (("run", "small-car-electric", "--cycle", "us6"), "cycle 'us6': not in the library, did you mean 'us06'?"),
        (("run", "small-car-electric", "--cycle", "missing.csv"), "missing.csv: cannot be read: No such file or directory"),
        ((*RUN, "--set", "motr.J=1"), "motr.J is not known, did you mean 'motor.J'?"),
        ((*RUN, "--set", "motor.J=5 kg"), 'motor.J = "5 kg", must be an inertia such as kg.m^2'),
        ((*RUN, "--set", "motor.J=many"), 'motor.J = "many", must be a number'),
        ((*RUN, "--set", "motor.J=nan"), "motor.J = nan, must be"),
        ((*RUN, "--set", "motor.J"), "--set motor.J: must be NAME=VALUE"),
        ((*RUN, "--mass", "-5"), "body.m = -5, must be >= 10 kg"),
        ((*RUN, "--mass", "nan"), "body.m = nan, must be >= 10 kg"),
        ((*RUN, "--mass", "1500", "--set", "body.m=1400"), "body.m is set 2 times"),
        ((*RUN, "--soc", "1.5"), "battery.soc_start = 1.5, must be >= 0 and <= 1"),
        (("run", "small-car-conventional", "--cycle", "us06", "--soc", "0.5"), "vehicle 'small-car-conventional' has no battery"),
        ((*RUN, "--dt", "nan"), "--dt nan s, must be > 0 s"),
        ((*RUN, "--dt", "0"), "--dt 0 s, must be > 0 s"),
        ((*RUN, "--dt", "1e-9"), "steps of cycle 'us06', must be at most"),
        ((*RUN, "--via", "fmu2", "--dt", "0.7"), "dt = 0.7 s leaves a last step of 0.1 s"),
        ((*RUN, "--via", "forward", "--mode", "refined"), "mode refined runs via step only, not via forward"),
        ((*RUN, "--out", "nowhere/run.nc"), "--out nowhere/run.nc: there is no folder nowhere"),
        ((*RUN, "--out", "."), "--out .: is a folder, must be a file"),
        ((*RUN, "--plot", "run.gif"), "a plot is written as .png, .svg, .pdf, not as '.gif'"),
        (("accelerate", "small-car-electric", "--to", "0"), "--to 0 km/h, must be > 0 and < 322 km/h"),
        (("fmu", "small-car-electric", "--fmi", "2", "-o", "car.zip"), "the name of an FMU ends in .fmu"),
        (("fmu", "small-car-electric", "--fmi", "2", "-o", "car.fmu", "--dt", "inf"), "--dt inf s, must be > 0 s"),
        (("fmu", "small-car-electric", "--fmi", "2", "-o", "car.fmu", "--grade", "a.csv"), "--grade goes with --cycle"),
        (("show", "us6"), "did you mean 'us06'?"),
    ],
)
def test_what_is_wrong_is_said_in_one_message(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in refused(*arguments)
    assert list(tmp_path.iterdir()) == []


def test_several_problems_come_at_once():
    text = refused("run", "smal-car-electric", "--cycle", "us6", "--dt", "-1", "--plot", "x.gif")
    for part in ("several things are wrong", "small-car-electric", "us06", "--dt -1 s", ".gif"):
        assert part in text


@pytest.mark.parametrize(
    "arguments", [("run",), ("run", "x", "--cycle", "y", "--via", "air"), ("list", "wheels"), ("nothing",), (*RUN, "--dt", "x")]
)
def test_wrong_usage_is_exit_code_2(arguments):
    result = call(*arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_a_cycle_whose_time_runs_backwards(tmp_path):
    path = tmp_path / "back.csv"
    path.write_text("time_s,speed_mps\n0,0\n2,1\n1,3\n")
    assert "line 4: time_s = 1 follows 2, it must rise" in refused("run", "small-car-electric", "--cycle", path)


def test_a_cycle_with_grade_by_distance(tmp_path):
    cycle, grade = tmp_path / "trip.csv", tmp_path / "road.csv"
    cycle.write_text("time_s,speed_kmh\n0,0\n20,50\n60,50\n80,0\n")
    grade.write_text("distance_m,grade\n0,0.02\n1000,0.02\n")
    found = json.loads(done("run", "small-car-electric", "--cycle", cycle, "--grade", grade, "--json"))
    assert found["account"]["potential_J"] > 0


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the administrator may write everywhere")
def test_a_read_only_folder_is_found_before_the_run(tmp_path):
    tmp_path.chmod(0o500)
    assert "cannot be written to" in refused(*RUN, "--out", tmp_path / "run.nc")


def test_a_full_disk_is_an_error_without_a_trace(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    assert "run.png: cannot be written: No space left on device" in refused(*RUN, "--plot", tmp_path / "run.png")
    assert list(tmp_path.iterdir()) == []


PROGRAM = (sys.executable, "-m", "halfshaft")


def without_compiler(*arguments, **settings):
    env = {**os.environ, "CC": "/nowhere/cc", **settings}
    return subprocess.run([*PROGRAM, *arguments], env=env, capture_output=True, text=True, check=False)


def test_without_a_compiler_it_runs_with_one_warning(tmp_path):
    result = without_compiler("run", "small-car-electric", "--cycle", "im240", "--json", HALFSHAFT_CACHE=str(tmp_path))
    assert result.returncode == 0
    (line,) = result.stderr.splitlines()
    assert line.startswith("warning: running without compiled code")
    found, compiled = json.loads(result.stdout), json.loads(done("run", "small-car-electric", "--cycle", "im240", "--json"))
    assert found["soc_end"] == pytest.approx(compiled["soc_end"], rel=1e-9)


def test_without_a_compiler_the_cache_serves():
    done("run", "small-car-electric", "--cycle", "im240", "--json")
    result = without_compiler("run", "small-car-electric", "--cycle", "im240", "--json")
    assert result.returncode == 0
    (line,) = result.stderr.splitlines()
    assert line.startswith("warning: the C compiler that the environment variable CC names was not found")


@pytest.mark.parametrize("arguments", [("fmu", "small-car-electric", "--fmi", "3", "-o", "car.fmu"), ("bench",)])
def test_without_a_compiler_there_is_no_fmu_and_no_bench(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HALFSHAFT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CC", "/nowhere/cc")
    text = "the C compiler that the environment variable CC names was not found or is not executable: /nowhere/cc"
    assert refused(*arguments) == f"error: {text}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore::halfshaft.fmu_build.compiler.SlowWarning")
def test_a_bench_with_a_compiler_that_fails_is_refused(tmp_path, monkeypatch):
    simulate._stepper.cache_clear()
    monkeypatch.setenv("HALFSHAFT_CACHE", str(tmp_path))
    monkeypatch.setenv("CC", "false")
    assert "the C compiler must work" in call("bench").stderr
    simulate._stepper.cache_clear()


SHELL = pytest.mark.skipif(os.name != "posix", reason="a shell and devices of POSIX")


def shell(text):
    """Return exit code and standard error of a command line; ``halfshaft`` in it is the program."""
    line = f'halfshaft() {{ {shlex.join(PROGRAM)} "$@"; }}; {text}'
    result = subprocess.run(["bash", "-c", line], capture_output=True, text=True, errors="replace", check=False)
    return result.returncode, result.stderr


@SHELL
@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("halfshaft list cycles > /dev/full", 2, "error: standard output or a temporary file: No space left on device\n"),
        ("halfshaft --help > /dev/full", 2, "error: standard output or a temporary file: No space left on device\n"),
        ("halfshaft --version > /dev/full", 2, "error: standard output or a temporary file: No space left on device\n"),
        ("halfshaft show us06 >&-", 2, "error: standard output: it is closed\n"),
        ("halfshaft show us06 2>&- >&-", 2, ""),
        ("halfshaft show us6 2>/dev/full", 2, ""),
        ("halfshaft list cycles | true; exit ${PIPESTATUS[0]}", 141, ""),
        ("halfshaft --help | true; exit ${PIPESTATUS[0]}", 141, ""),
        ("LC_ALL=C.UTF-8 halfshaft show $'\\xff'", 2, "error: '\\udcff': no vehicle"),
    ],
)
def test_an_output_that_cannot_be_written_is_an_error_or_the_end(text, code, said):
    found, stderr = shell(text)
    assert (found, stderr[: len(said)]) == (code, said)
    assert len(stderr.splitlines()) <= 1


def test_another_failure_of_the_system_is_one_message_too(monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("halfshaft.cosim.by_fmu.march_fmu", full)
    assert refused(*RUN, "--via", "fmu3") == "error: standard output or a temporary file: No space left on device\n"


def interrupted(code, after, *arguments, ignored=False):
    """Interrupt a program so long after it says that it is on; return its exit code and standard error."""
    # An interrupt that a shell lets a job in the background ignore is inherited.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_IGN if ignored else signal.SIG_DFL)
    command = [sys.executable, "-c", code, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed) as run:
        try:
            assert run.stdout.readline() == "on\n"
            time.sleep(after)
            run.send_signal(signal.SIGINT)
            _, stderr = run.communicate(timeout=60)
        finally:
            run.kill()
    return run.returncode, stderr


def program(body):
    """Return a program that runs Python in place of the commands."""
    lines = "\n    ".join(body.strip().splitlines())
    return f"""import casadi, time
from halfshaft.__main__ import main
from halfshaft.app import cli

def app():
    {lines}

cli.app = app
main()
"""


@SHELL
@pytest.mark.parametrize("after", [0.02, 0.3, 1.0, 2.0])
def test_an_interrupt_is_one_line_at_any_time(after):
    # At the start of Python itself a program cannot do better than Python.
    code, stderr = interrupted("from halfshaft.__main__ import main; print('on', flush=True); main()", after, "reproduce")
    assert stderr == "interrupted\n"
    # A shell shows both as 130; Python ends by the signal where it caught it inside an exec() of a string.
    assert code in (130, -signal.SIGINT)


@SHELL
def test_an_interrupt_where_casadi_looks_at_an_operand_is_not_lost():
    # It asks whether that is a sparse matrix of SciPy, and drops what is raised there.
    looks = program("""
class Operand:
    @property
    def tocsc(self):
        print("on", flush=True)
        end = time.monotonic() + 0.15
        while time.monotonic() < end:
            pass
        raise AttributeError

try:
    casadi.SX(2) * Operand()
except TypeError:
    pass
time.sleep(100)
""")
    assert interrupted(looks, 0.05) == (130, "interrupted\n")


@SHELL
def test_an_interrupt_in_a_finaliser_is_not_lost():
    # Python has a callback of that kind at the end of each import.
    ends = program("""
class Ends:
    def __del__(self):
        print("on", flush=True)
        end = time.monotonic() + 0.15
        while time.monotonic() < end:
            pass

Ends()
time.sleep(100)
""")
    assert interrupted(ends, 0.05) == (130, "interrupted\n")


@SHELL
def test_an_interrupt_while_casadi_computes_is_heard():
    computes = program("""
t, x = casadi.SX.sym("t"), casadi.SX.sym("x")
long = casadi.integrator("long", "cvodes", {"t": t, "x": x, "ode": casadi.sin(t)}, 0, 1e9, {"max_num_steps": 10**9})
print("on", flush=True)
long(x0=0)
""")
    code, stderr = interrupted(computes, 0.1)
    # SUNDIALS has its say before.
    assert (code, stderr.splitlines()[-1]) == (130, "interrupted")


@SHELL
def test_an_interrupt_while_a_class_is_made_is_one_line():
    # Python 3.11 makes a RuntimeError of it.
    makes = program("""
class Named:
    def __set_name__(self, owner, name):
        print("on", flush=True)
        time.sleep(100)

type("Owner", (), {"named": Named()})
""")
    assert interrupted(makes, 0.1) == (130, "interrupted\n")


@SHELL
def test_a_program_that_was_told_to_ignore_interrupts_does():
    assert interrupted(program('print("on", flush=True)\ntime.sleep(0.5)'), 0.1, ignored=True) == (0, "")


def test_a_name_that_is_too_long_is_said_before_the_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "a" * 300
    text = refused(*RUN, "--out", f"{name}.nc", "--plot", f"{name}.png")
    assert text.count("cannot be written: File name too long") == 2
    assert "cannot be written: File name too long" in refused("fmu", "small-car-electric", "--fmi", "3", "-o", f"{name}.fmu")
    assert "cannot be written: File name too long" in refused("reproduce", "--out", name)


def test_a_bad_date_is_one_message(tmp_path, monkeypatch):
    result = simulate.run(halfshaft.Vehicle.load("small-car-electric"), halfshaft.Cycle.load("us06"))
    for bad in ("abc", "-1", "1e9", "9" * 5000):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", bad)
        text = refused("show", "small-car-series")
        assert f'SOURCE_DATE_EPOCH = "{bad[:40]}", must be whole seconds since 1970' in text
        for ending in ("svg", "pdf"):
            with pytest.raises(halfshaft.InputError, match="must be whole seconds since 1970"):
                halfshaft.plot_run(result, path=tmp_path / f"run.{ending}")
    # An empty one is none; NumPy, which has not read it yet in a process of its own, would take it for a bad one.
    assert shell(f"SOURCE_DATE_EPOCH= halfshaft run small-car-electric --cycle us06 --out {tmp_path}/run.nc > /dev/null") == (0, "")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "5000000000")
    done(*RUN, "--plot", tmp_path / "run.svg")


@SHELL
def test_what_is_no_file_stays_what_it_is(tmp_path):
    pipe, link, loop = tmp_path / "pipe.nc", tmp_path / "link.nc", tmp_path / "loop.nc"
    os.mkfifo(pipe)
    # A pipe of its own: a check that fails must not cost the system one of its devices.
    link.symlink_to(pipe)
    loop.symlink_to(loop)
    for path in (pipe, link):
        assert "is a device or a pipe, must be a file" in refused(*RUN, "--out", path)
    assert "cannot be written: Too many levels of symbolic links" in refused(*RUN, "--out", loop)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert link.is_symlink()


def test_acceleration():
    found = json.loads(done("accelerate", "small-car-electric", "--json"))
    assert found.keys() == {"time_s", "mode", "hybrid_s", "refined_s"}
    assert found["mode"] == "refined"
    heavier = json.loads(done("accelerate", "small-car-electric", "--mass", "1600", "--json"))
    assert heavier["time_s"] > found["time_s"] > 3
    assert "0 to 100 km/h" in done("accelerate", "small-car-electric")


def test_acceleration_compared():
    found = json.loads(done("accelerate", "small-car-electric", "--compare", "--json"))
    assert found.keys() == {"time_s", "mode", "hybrid_s", "iteration_s", "refined_s", "forward_s"}
    assert found["refined_s"] == pytest.approx(found["iteration_s"], rel=1e-3)
    assert found["forward_s"] == pytest.approx(found["iteration_s"], rel=0.02)


def test_a_speed_that_is_never_reached_is_null():
    assert json.loads(done("accelerate", "small-car-electric", "--to", "300", "--json"))["time_s"] is None
    text = done("accelerate", "small-car-electric", "--to", "300")
    assert "not reached" in text
    assert "highest speed 158.0 km/h" in text


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_fmu_with_the_cycle_inside(fmi, tmp_path):
    import fmpy

    path = tmp_path / "us06.fmu"
    done("fmu", "small-car-electric", "--fmi", fmi, "--cycle", "us06", "--mass", "1300", "-o", path)
    result = fmpy.simulate_fmu(str(path), output=["battery.soc"])
    found = json.loads(done(*RUN, "--mass", "1300", "--json"))
    assert result["time"][-1] == 600
    assert result["battery.soc"][-1] == pytest.approx(found["soc_end"], rel=1e-12)


def test_driven_fmu_has_the_vehicles_numbers(tmp_path):
    import fmpy

    path = tmp_path / "car.fmu"
    assert "requested speed" in done("fmu", "small-car-electric", "--fmi", "3", "--set", "body.m=1.3 t", "-o", path)
    description = fmpy.read_model_description(str(path))
    start = {v.name: v.start for v in description.modelVariables}
    assert float(start["body.m"]) == 1300
    assert fmpy.simulate_fmu(str(path), stop_time=3.0)["time"][-1] == 3.0


@pytest.mark.parametrize("what", ["vehicles", "components", "cycles"])
def test_list_names_all(what):
    text = done("list", what)
    for name in {"vehicles": halfshaft.vehicle_names, "components": halfshaft.component_names, "cycles": halfshaft.cycle_names}[what]():
        assert name in text


@pytest.mark.parametrize("name", [*halfshaft.vehicle_names(), *halfshaft.component_names(), *halfshaft.cycle_names()])
def test_show_knows_everything(name):
    assert name in done("show", name)


def test_show_gives_value_unit_and_meaning():
    text = done("show", "small-car-electric")
    for expected in ("body.m", "1144", "kg", "gearbox.ratios_1", "rule", "ac-75kw", "ADVISOR 2003"):
        assert expected in text


def test_components_of_one_kind_are_listed_with_power_and_mass():
    rows = {line.split()[0]: line.split() for line in done("list", "components", "--kind", "motor").splitlines() if "motor" in line}
    assert rows.keys() >= set(halfshaft.component_names("motor"))
    assert rows["ac-75kw"][1:4] == ["motor", "74.6", "91"]
    # What has neither shows neither.
    assert next(line for line in done("list", "components").splitlines() if "final-3.93" in line).split()[1:3] == ["final-drive", "Final"]
    assert "'moto' is not a kind of component, did you mean 'motor'?" in refused("list", "components", "--kind", "moto")
    assert "goes with components, not with cycles" in refused("list", "cycles", "--kind", "motor")


@pytest.mark.parametrize("name", ["small-car-series", "si-41kw", "small-car-conventional", "five-speed-map"])
def test_show_prints_a_file_to_edit(name, tmp_path):
    path = tmp_path / f"{name}.toml"
    text = done("show", name, "--toml")
    path.write_text(text)
    assert done("show", path, "--toml") == text
    assert "is a cycle, a CSV file" in refused("show", "us06", "--toml")


def test_show_draws_the_maps_of_a_component(tmp_path):
    path = tmp_path / "map.png"
    assert f"wrote {path}" in done("show", "si-41kw", "--plot", path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert "only the maps of a component are drawn" in refused("show", "small-car-series", "--plot", path)
    assert "there is no folder" in refused("show", "si-41kw", "--plot", tmp_path / "none" / "map.png")


def test_show_reads_files(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('schema = 1\nkind = "vehicle"\nname = "mine"\ntitle = "Mine"\nbase = "small-car-electric"\n[set]\n"body.m" = "1.2 t"\n')
    assert "1200" in done("show", path)
    path.write_text("schema = 2\n")
    assert "this version reads schema 1" in refused("show", path)


def test_output_survives_a_terminal_without_unicode():
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-c", "from halfshaft.app.cli import app; app()", "show", "small-car-series"]
    result = subprocess.run(command, env=env, capture_output=True, check=False)
    assert result.returncode == 0
    assert result.stdout.isascii()


def test_version_and_help():
    assert done("--version") == f"halfshaft {halfshaft.__version__}\n"
    for command in ("run", "accelerate", "fmu", "reproduce", "bench", "list", "show"):
        assert f"halfshaft {command}" in done(command, "--help")


def test_public_names():
    for name in halfshaft.__all__:
        assert getattr(halfshaft, name) is not None
        assert name in dir(halfshaft)
    with pytest.raises(AttributeError, match="no attribute 'runn'"):
        _ = halfshaft.runn


def test_importing_the_package_is_cheap():
    code = "import sys, halfshaft; sys.exit('casadi' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_map_cannot_be_set_to_a_number():
    text = refused(*RUN, "--set", "motor.tau_max=200")
    assert "motor.tau_max is a map, not a number: stretch it by motor.speed_scale or motor.torque_scale" in text
    assert "or replace the motor" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*RUN, "--via", "air"), "Invalid value for '--via': 'air' is not one of 'step', 'fmu2', 'fmu3', 'forward'."),
        ((*RUN, "--dt", "x"), "Invalid value for '--dt': must be a number"),
        (("list", "wheels"), "'wheels' is not one of"),
    ],
)
def test_no_library_speaks_in_our_messages(arguments, message):
    text = call(*arguments).stderr
    assert message in text
    assert "Value error" not in text
    assert "Input should" not in text


@pytest.mark.parametrize("command", ["run", "accelerate", "fmu", "reproduce", "bench", "list", "show"])
def test_help_fits_a_terminal_of_80_columns(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, done(command, "--help").splitlines())) <= 80


def test_a_run_fits_a_terminal_of_80_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = done("run", "small-car-series", "--cycle", "us06")
    lines = [line for line in text.splitlines() if not line.startswith("  ! ")]
    assert max(map(len, lines)) <= 80
    assert "…" not in text


def test_an_unbalanced_economy_has_its_correction_beside_it():
    text = done("run", "small-car-series", "--cycle", "hwfet")
    for expected in ("economy, fuel alone", "1.142 L/100 km", "with battery as fuel", "5.676 L/100 km", "genset, own mean", "31.4 %"):
        assert expected in text
    assert "genset, nominal" in done("run", "small-car-series", "--cycle", "udds")


def test_units_of_the_us():
    text = done(*RUN, "--units", "us")
    for expected in ("8.007 mi", "338.1 Wh/mi", "99.7 MPGe", "range on it", "23 mi", "mph", "137.1 kW"):
        assert expected in text
    assert "km" not in text
    assert "mpg" in done("run", "small-car-conventional", "--cycle", "us06", "--units", "us")
    # What a program reads stays as it is.
    assert done(*RUN, "--units", "us", "--json") == done(*RUN, "--json")
    assert "from 0 to 60 mph" in done("accelerate", "small-car-electric", "--units", "us")
    assert "--to 250 mph, must be > 0 and < 200 mph" in refused("accelerate", "small-car-electric", "--units", "us", "--to", "250")


def test_efficiencies_stand_in_the_energy_table():
    text = done(*RUN)
    assert "eff. %" in text
    (motor,) = [line.split() for line in text.splitlines() if line.split()[:1] == ["motor"] and len(line.split()) == 5]
    received, delivered, _, efficiency = map(float, motor[1:])
    assert efficiency == pytest.approx(100 * delivered / received, abs=0.06)


def test_the_hybrid_time_stands_beside_the_refined_one():
    lines = [line.split() for line in done("accelerate", "small-car-electric").splitlines()]
    assert ["refined", "10.430"] in lines
    assert ["hybrid", "11.259"] in lines
    assert ["refined", "10.430"] not in [x.split() for x in done("accelerate", "small-car-electric", "--mode", "iteration").splitlines()]


def test_without_a_compiler_the_header_says_so(tmp_path):
    result = without_compiler("run", "small-car-electric", "--cycle", "im240", HALFSHAFT_CACHE=str(tmp_path))
    assert "interpreted step" in result.stdout
    assert "compiled step" not in result.stdout


def test_a_shell_can_complete_names():
    env = {**os.environ, "_HALFSHAFT_COMPLETE": "complete_bash", "COMP_WORDS": "halfshaft run small-car-e", "COMP_CWORD": "2"}
    command = [sys.executable, "-c", "from halfshaft.app.cli import app; app(prog_name='halfshaft')"]
    result = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert "small-car-electric" in result.stdout.split()
    assert all(name.startswith("small-car-e") for name in result.stdout.split())
    assert "--install-completion" in done("--help")
