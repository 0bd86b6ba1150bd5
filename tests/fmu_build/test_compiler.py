import ctypes
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from halfshaft.fmu_build import compiler
from halfshaft.fmu_build.compiler import SlowWarning, find_compiler, shared_library
from halfshaft.library.base.errors import CompileError

SOURCE = '#include "twice.h"\n__attribute__((visibility("default"))) int twice(int x) { return TWO * x; }\n'
HEADERS = {"twice.h": "#define TWO 2\n"}


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("HALFSHAFT_CACHE", str(tmp_path / "cache ü"))
    compiler._warned.clear()
    return tmp_path / "cache ü"


def call(library):
    return ctypes.CDLL(str(library)).twice(21)


def test_compiles_once(cache):
    library = shared_library(SOURCE, "twice", HEADERS)
    made = library.stat().st_mtime_ns
    assert call(library) == 42
    assert shared_library(SOURCE, "twice", HEADERS).stat().st_mtime_ns == made
    assert [p.name for p in cache.iterdir()] == [library.name]


def test_another_header_makes_another_library():
    assert shared_library(SOURCE, "twice", HEADERS) != shared_library(SOURCE, "twice", {"twice.h": "#define TWO 3\n"})


@pytest.mark.parametrize("flags", ["FLAGS", "GCC_FLAGS"])
def test_other_flags_make_another_library(flags, monkeypatch):
    if "Free Software Foundation" not in find_compiler().identity:
        pytest.skip("not GCC")
    source = SOURCE.partition("\n")[2]
    monkeypatch.setattr(compiler, flags, (*getattr(compiler, flags), "-DTWO=2"))
    assert call(shared_library(source, "twice")) == 42
    monkeypatch.setattr(compiler, flags, (*getattr(compiler, flags)[:-1], "-DTWO=3"))
    assert call(shared_library(source, "twice")) == 63


def test_no_place_of_this_machine_in_the_library(cache):
    assert os.fsencode(cache.parent) not in shared_library(SOURCE, "twice", HEADERS).read_bytes()


def test_compiler_messages_are_shown():
    with pytest.raises(CompileError, match=r"failed on twice\.c:[\s\S]*twice\.h"):
        shared_library(SOURCE, "twice")


def test_no_compiler(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(CompileError, match=r"pip install halfshaft\[compiler\]"):
        find_compiler()


def test_ziglang_is_the_last_resort(monkeypatch):
    pytest.importorskip("ziglang")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "/nowhere/else")
    assert find_compiler().command[1:4] == ("-m", "ziglang", "cc")


def test_wrong_CC_is_named(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -m64")
    with pytest.raises(CompileError, match="no-such-compiler"):
        find_compiler()


@pytest.mark.filterwarnings("ignore::halfshaft.fmu_build.compiler.SlowWarning")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cc 'unbalanced", "CC is not a command"),
        ("''", "was not found"),
        ("{plain}", "is not executable"),
        ("{garbage}", "cannot be run"),
        ("{crash}", r"crashes \(signal 11\)"),
        ("true", r"true failed on twice.c:\s+exit code 0, nothing said, no library"),
        ("{nothing}", "no place to compile twice and load it: .*twice"),
    ],
)
def test_a_CC_that_is_no_compiler_is_said(text, message, monkeypatch, tmp_path):
    plain, garbage, crash, nothing = (tmp_path / name for name in ("plain", "garbage", "crash", "nothing"))
    plain.write_text("#!/bin/sh\n")
    garbage.write_bytes(b"\0\0\0")
    crash.write_text("#!/bin/sh\nkill -SEGV $$\n")
    nothing.write_text("#!/bin/sh\ncase $* in *twice*) echo no library > twice.so;; esac\n")
    for program in (garbage, crash, nothing):
        program.chmod(0o755)
    monkeypatch.setenv("CC", text.format(plain=plain, garbage=garbage, crash=crash, nothing=nothing))
    with pytest.raises(CompileError, match=message):
        shared_library(SOURCE, "twice", HEADERS)


def test_arguments_in_CC(monkeypatch):
    monkeypatch.setenv("CC", "cc -DTWO=2")
    assert call(shared_library(SOURCE.split("\n", 1)[1], "twice")) == 42


def test_unwritable_cache_warns_once_and_works(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("HALFSHAFT_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.warns(SlowWarning, match="HALFSHAFT_CACHE"):
        library = shared_library(SOURCE, "twice", HEADERS)
    assert call(library) == 42
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert shared_library(SOURCE, "twice", HEADERS) == library


def emptied(content):
    return b""


def cut(content):
    return content[: len(content) // 2]


def overwritten(content):
    return b"no library" * 1000


def zeroed(content):
    return content[:4096] + bytes(4096) + content[8192:]


@pytest.mark.parametrize("damage", [emptied, cut, overwritten, zeroed])
def test_a_damaged_library_is_compiled_anew_with_one_warning(damage, cache):
    library = shared_library(SOURCE, "twice", HEADERS)
    content = library.read_bytes()
    # Never written in place: the library is loaded in this process.
    library.unlink()
    library.write_bytes(damage(content))
    with pytest.warns(SlowWarning, match="is damaged: compiled anew") as said:
        library = shared_library(SOURCE, "twice", HEADERS)
    assert len(said) == 1
    assert library.read_bytes() == content
    assert [p.name for p in cache.iterdir()] == [library.name]


def test_without_a_compiler_the_cache_serves(monkeypatch):
    library = shared_library(SOURCE, "twice", HEADERS)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda _: None)
    compiler._find_compiler.cache_clear()
    assert shared_library(SOURCE, "twice", HEADERS) == library
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.warns(SlowWarning, match="no-such-compiler; what the cache .* holds is used"):
        assert shared_library(SOURCE, "twice", HEADERS) == library
    with pytest.raises(CompileError, match="no-such-compiler"):
        shared_library(SOURCE, "twice", {"twice.h": "#define TWO 3\n"})
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, "-O2"))
    with pytest.raises(CompileError, match="no-such-compiler"):
        shared_library(SOURCE, "twice", HEADERS)


def test_a_cache_in_which_nothing_may_be_executed(cache, monkeypatch):
    load = ctypes.CDLL

    def refuse(path):
        if Path(path).is_relative_to(cache):
            raise OSError(f"{path}: failed to map segment from shared object: Operation not permitted")
        return load(path)

    monkeypatch.setattr(compiler.ctypes, "CDLL", refuse)
    with pytest.warns(SlowWarning, match="cannot be used .*Operation not permitted"):
        library = shared_library(SOURCE, "twice", HEADERS)
    assert not library.is_relative_to(cache)
    monkeypatch.setattr(compiler, "_private_folder", lambda: cache)
    with pytest.raises(CompileError, match=r"no place to compile twice and load it: .*Operation not permitted"):
        shared_library(SOURCE, "twice", {"twice.h": "#define TWO 4\n"})


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only the administrator gives files away")
def test_a_library_of_another_user_where_everybody_writes_is_not_loaded(cache):
    library = shared_library(SOURCE, "twice", HEADERS)
    cache.chmod(0o1777)
    os.chown(library, 12345, -1)
    with pytest.warns(SlowWarning, match="belongs to another user"):
        assert not shared_library(SOURCE, "twice", HEADERS).is_relative_to(cache)


def test_old_libraries_and_abandoned_builds_go(cache, monkeypatch):
    def make(two):
        return shared_library(SOURCE, "twice", {"twice.h": f"#define TWO {two}\n"})

    def age(path, days):
        os.utime(path, (time.time() - 86400 * days,) * 2)

    old, used, other = make(1), make(2), cache / "notes.txt"
    abandoned, busy = cache / ".build-abandoned", cache / ".build-busy"
    for folder in (abandoned, busy):
        folder.mkdir()
        (folder / "twice.c").touch()
    other.touch()
    for path, days in ((old, 100), (used, 100), (other, 100), (abandoned, 0.1)):
        age(path, days)
    make(2)  # A use.
    new = make(3)
    assert set(cache.iterdir()) == {used, new, other, busy}
    age(used, 1)
    monkeypatch.setattr(compiler, "LARGEST", new.stat().st_size * 5 // 2)
    newest = make(4)
    assert set(cache.iterdir()) == {new, newest, other, busy}


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupted_build_leaves_nothing(cache, tmp_path):
    slow = tmp_path / "cc"
    slow.write_text('#!/bin/sh\n[ "$1" = --version ] && exit\necho > twice.o; echo >&2 begun; touch "$BEGUN"; exec sleep 60\n')
    slow.chmod(0o755)
    begun = tmp_path / "begun"
    code = f"from halfshaft.fmu_build.compiler import shared_library; shared_library({SOURCE!r}, 'twice', {HEADERS!r})"
    environment = {**os.environ, "CC": str(slow), "BEGUN": str(begun)}
    run = subprocess.Popen(
        [sys.executable, "-c", code],
        env=environment,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        # A shell that runs the tests in the background lets them inherit that interrupts are ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    for _ in range(600):
        if begun.exists():
            break
        time.sleep(0.05)
    os.killpg(run.pid, signal.SIGINT)
    assert run.wait(20) != 0
    assert list(cache.iterdir()) == []


def test_two_processes_fill_the_cache_at_once(cache):
    code = f"from halfshaft.fmu_build.compiler import shared_library; print(shared_library({SOURCE!r}, 'twice', {HEADERS!r}))"
    runs = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(4)]
    libraries = {run.communicate()[0].strip() for run in runs}
    assert all(run.returncode == 0 for run in runs)
    assert len(libraries) == 1
    assert call(libraries.pop()) == 42
    assert len(list(cache.iterdir())) == 1
