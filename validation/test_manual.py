"""The manual is built with all of its pictures, the slow ones too."""

import os
import subprocess
import sys
from pathlib import Path


def test_the_manual_has_all_of_its_pictures(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=Path(__file__).parents[1], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pictures = list(tmp_path.glob("pictures/*.png"))
    # An empty one takes a few kilobytes.
    assert pictures
    assert all(picture.stat().st_size > 20_000 for picture in pictures)
