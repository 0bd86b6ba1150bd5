import os
import stat

import pytest

from halfshaft import InputError
from halfshaft.library.files.writing import written_whole


def write(path, text="new"):
    with written_whole(path) as part:
        part.write_text(text)


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_a_file_keeps_its_permissions(tmp_path):
    path = tmp_path / "run.nc"
    path.touch()
    path.chmod(0o600)
    write(path)
    assert path.read_text() == "new"
    assert mode(path) == 0o600


def test_a_new_file_has_the_permissions_that_the_user_wants(tmp_path):
    (tmp_path / "plain").touch()
    write(tmp_path / "run.nc")
    assert mode(tmp_path / "run.nc") == mode(tmp_path / "plain")


def test_a_link_stays_and_what_it_points_to_is_written(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "run.nc", tmp_path / "link.nc"
    link.symlink_to(target)
    for text in ("first", "second"):
        write(link, text)
        assert link.is_symlink()
        assert target.read_text() == text
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["link.nc", "run.nc", "there"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("pipe", "is a device or a pipe, must be a file"),
        (".", "is a folder, must be a file"),
        ("loop", "cannot be written: Too many levels of symbolic links"),
        ("missing/run.nc", "there is no folder"),
        ("plain/run.nc", "there is no folder"),
        ("a" * 300, "cannot be written: File name too long"),
        ("a\0b", "cannot be written: embedded null byte"),
    ],
)
@pytest.mark.skipif(os.name != "posix", reason="devices and links of POSIX")
def test_what_is_no_file_is_refused_and_stays(name, message, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "plain").touch()
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match=message):
        write(f"{tmp_path}/{name}")
    assert sorted(tmp_path.iterdir()) == before
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the administrator may write everywhere")
def test_a_file_that_must_not_be_written_to_is_left(tmp_path):
    path = tmp_path / "run.nc"
    path.write_text("old")
    path.chmod(0o444)
    with pytest.raises(InputError, match="must not be written to"):
        write(path)
    assert path.read_text() == "old"


def interrupted(path):
    with written_whole(path) as part:
        part.write_text("half")
        raise KeyboardInterrupt


def test_what_is_interrupted_leaves_the_old_file(tmp_path):
    path = tmp_path / "run.nc"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        interrupted(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
