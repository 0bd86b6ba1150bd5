import ctypes
import os
import subprocess
import sys
import warnings

import pytest

from halfshaft.fmu_build import compiler
from halfshaft.fmu_build.compiler import SlowWarning, find_compiler, shared_library
from halfshaft.library.errors import CompileError

SOURCE = '#include "twice.h"\n__attribute__((visibility("default"))) int twice(int x) { return TWO * x; }\n'
HEADERS = {"twice.h": "#define TWO 2\n"}


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("HALFSHAFT_CACHE", str(tmp_path / "cache ü"))
    compiler._warn_once.cache_clear()
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


def test_two_processes_fill_the_cache_at_once(cache):
    code = f"from halfshaft.fmu_build.compiler import shared_library; print(shared_library({SOURCE!r}, 'twice', {HEADERS!r}))"
    runs = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(4)]
    libraries = {run.communicate()[0].strip() for run in runs}
    assert all(run.returncode == 0 for run in runs)
    assert len(libraries) == 1
    assert call(libraries.pop()) == 42
    assert len(list(cache.iterdir())) == 1
