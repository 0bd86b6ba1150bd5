"""Files that nobody should write: good ones of the library, changed at random, loaded and run.

Whatever a file holds, it either loads, and then runs with finite outputs and a closed account, or it is refused with one of
the project's own errors.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from importlib.resources import files
from pathlib import Path

import numpy as np

from halfshaft.cosim.account import account
from halfshaft.cosim.compiled import InterpretedStep
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.remarks import OPEN_BALANCE
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Build, parameters_of, run
from halfshaft.library.base.errors import HalfshaftError
from halfshaft.library.base.tables import interpolants
from halfshaft.library.files.component_file import component_names, read_component
from halfshaft.models.assembly import assemble
from halfshaft.models.powertrain import powertrains, vehicle_files
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.procedure import joined
from halfshaft.studies.procedure_file import Plan, procedure_texts

#: What takes the place of a number, a text or a whole value.
NUMBERS = (
    "0", "-0.0", "1", "-1", "1e308", "-1e308", "1e400", "5e-324", "1e-300", "nan", "-inf", "9" * 5000, "0x" + "f" * 5000, "1_0", "true",
    "[]", "[[1], [2, 3]]", "{}", '"3 kg"', '"x"', '"1e9 dBm"', '"1e308 km"', "1979-05-27", "", "1,5", "0.5", "2", "100", "65536",
)  # fmt: skip
TEXTS = (
    "*/ int x; /*", "\\u001b[31m", "\\u202e", "\\u0000", "\\u2028", "\\n", "../../x.toml", "a\\u0000.toml", "dBm", "m**9**9", "degF", "%",
    "small-car-series", "pm-32kw", "rpm", "'" * 300, "\\U0001F697", "", "x" * 5000,
)  # fmt: skip
BYTES = (b"\0", b"\xff", b"\x1b", b'"', b"[", b"{", b"=", b"\n", b".", b",", b";", b"#", b"\xe2\x80\xae", b"9" * 400, b"[" * 5000)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
#: Files of more characters are left out.
SMALL = 20_000
#: A minute of driving with rest, acceleration and braking.
TRACE = Cycle(name="minute", time=np.array([0.0, 5, 20, 40, 55, 60]), speed=np.array([0.0, 0, 15, 12, 0, 0]))


def changed(text: str, rng: random.Random) -> bytes:
    """Return a file with one to three changes of its structure, its numbers, its texts or its bytes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        text = rng.choice((_number, _number, _number, _text, _lines, _nested))(text, rng)
    content = text.encode(errors="surrogatepass")
    if rng.random() < 0.2:
        at = rng.randrange(len(content) + 1)
        content = content[:at] + rng.choice(BYTES) + content[at + rng.choice((0, 0, 1, 3, 200)) :]
    return content


def _put(text: str, rng: random.Random, pattern: str | re.Pattern[str], new: str) -> str:
    found = list(re.finditer(pattern, text))
    if not found:
        return text
    # Half of all changes in the first lines: most of a file is its map.
    m = rng.choice(found[: rng.choice((12, len(found)))])
    return text[: m.start()] + new + text[m.end() :]


def _number(text: str, rng: random.Random) -> str:
    return _put(text, rng, NUMBER, rng.choice(NUMBERS) if rng.random() < 0.7 else f"{rng.lognormvariate(0, 5):.6g}")


def _text(text: str, rng: random.Random) -> str:
    return _put(text, rng, r'"[^"\n]*"', f'"{rng.choice(TEXTS)}"')


def _lines(text: str, rng: random.Random) -> str:
    lines = text.split("\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    rng.choice((lambda: lines.pop(i), lambda: lines.insert(j, lines[i]), lambda: lines.__setitem__(i, lines[j])))()
    return "\n".join(lines)


def _nested(text: str, rng: random.Random) -> str:
    return _put(text, rng, r"(?m)^\w+ =", f"{'.'.join(['title'] * rng.choice((2, 40, 5000)))} =")


@cache
def _sources() -> list[tuple[str, str, Callable[[Path], Vehicle | Cycle | None]]]:
    """Return name, text and reader of the files that are changed; components in a vehicle that can take them."""
    found: list[tuple[str, str, Callable[[Path], Vehicle | Cycle | None]]] = []
    for file in (read_component(name, ("omega_locus",)) for name in component_names()):
        text = Path(file.path).read_text(encoding="utf-8")
        # A large map takes long to read, and is no other than a small one.
        if len(text) < SMALL:
            found.append((f"{file.name}.toml", text, partial(_in_vehicle, file.kind)))
    vehicles = [(path.name, path.read_text(encoding="utf-8"), Vehicle.load) for path in vehicle_files().values()]
    folder = files("halfshaft.cosim") / "data"
    lines = (folder / "cycles" / "im240.csv").read_text(encoding="utf-8").split("\n")
    grade = (folder / "grades" / "hwfet-mtn.csv").read_text(encoding="utf-8")
    trip = "# title: trip\nTime [s];Speed (km/h);grade_percent;key_on\n0;0;0;1\n1,5;3,6;1;1\n3;-0,1;0;1\n9;36;2,5;0\n20;0;0;1\n"
    cycles = [
        ("im240.csv", "\n".join(lines[:60]), Cycle.load),
        ("trip.csv", trip, Cycle.load),
        ("grade.csv", grade, lambda path: Cycle.load("im240", path)),
    ]
    plans = [(f"{name}.toml", text, _planned) for name, text in procedure_texts().items() if len(text) < SMALL]
    # As many vehicles, cycles and procedures as components.
    return [x for kind in (found, vehicles, cycles, plans) for x in len(found) // len(kind) * kind]


def _planned(path: Path) -> None:
    for test in Plan.load(path).tests:
        joined(test, 2 if test.repeat else 1)


def _in_vehicle(kind: str, path: Path) -> Vehicle | None:
    for base in ("small-car-series", "small-car-conventional", "paper-series-1459"):
        powertrain = powertrains()[_vehicle(base).powertrain]
        roles = [role for role in powertrain.roles if kind in powertrain.kinds(role)]
        if roles and (kind != "shift" or "conventional" in base):
            return _vehicle(base).with_parts({roles[0]: path})
    return None


_vehicle = cache(Vehicle.load)
_known: set[Build] = set()


def _drive(car: Vehicle, cycle: Cycle) -> None:
    """Run, with code that is there already or on CasADi's virtual machine: a map of its own would take a second to compile."""
    if not _known:
        _known.update(Build(_vehicle(name)) for name in vehicle_names())
    if Build(car) in _known:
        result = run(car, cycle)
        rows, open_by = result.history, result.account.balance_relative
    else:
        step = assemble(car.model(), car.title, interpolants)
        samples = cycle.sampled(1.0)
        history = InterpretedStep(step).march(samples, parameters_of(car, step, samples.v_start)).history
        assert history is not None
        rows = history
        sums = dict(zip((d.name for d in step.outputs), (rows.T @ samples.dt).tolist(), strict=True))
        open_by = account(step.outputs, sums).balance_relative
    if not np.all(np.isfinite(rows)):
        raise AssertionError("an output is not finite")
    if len(rows) and not abs(open_by) < OPEN_BALANCE:
        raise AssertionError(f"the account is open by {open_by:g}")


def attempt(folder: Path, seed: int) -> str:
    """Change one file of the library, load and run it; return what became of it, an error of the project's own included.

    Raises
    ------
    AssertionError
        If an output is not finite, the account is open, or a text of the file has control characters.

    """
    rng = random.Random(seed)
    name, text, load = rng.choice(_sources())
    path = folder / name
    path.write_bytes(changed(text, rng))
    try:
        found = load(path)
        if found is None:
            return "loaded"
        if not (found.title + found.source + found.name).isprintable():
            raise AssertionError("a text has control characters")
        if isinstance(found, Vehicle):
            _drive(found, TRACE)
        else:
            cut = found.time <= found.time[0] + 200
            rows = {n: x[cut] for n in ("time", "speed", "grade", "key_on") if (x := getattr(found, n)) is not None}
            _drive(_vehicle("small-car-electric"), replace(found, **rows))
    except HalfshaftError as error:
        return type(error).__name__
    finally:
        path.unlink()
    return "ran"


def attempt_result(content: bytes, path: Path, seed: int) -> str:
    """Change the bytes of a saved run at random and load it; return whether it loaded or was refused."""
    rng = random.Random(seed)
    broken = bytearray(content)
    for _ in range(rng.choice((1, 3, 30))):
        at = rng.randrange(len(broken) if rng.random() < 0.5 else min(len(broken), 20_000))
        broken[at : at + rng.choice((1, 1, 8))] = rng.randbytes(rng.choice((1, 1, 8)))
    path.write_bytes(bytes(broken[: rng.choice((len(broken), len(broken), rng.randrange(len(broken))))]))
    try:
        _ = Result.load(path).summary
    except HalfshaftError:
        return "refused"
    return "loaded"
