"""The site builds without a warning, tutorials and their pictures included."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    # A copy, as the build writes pages beside the sources, and another build may be doing so.
    made = shutil.ignore_patterns("generated", "gallery", "__pycache__")
    for folder in ("docs", "plugins", "contrib", "examples/tutorials"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=made)
    for file in ("README.md", "examples/harbour.toml"):
        shutil.copy(ROOT / file, tmp_path / file)
    out = tmp_path / "site"
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", tmp_path / "docs", out],
        cwd=tmp_path, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(list(out.glob("_images/sphx_glr_*"))) >= 5, "the tutorials' pictures were not made"
    arrays = [p for p in out.glob("_images/*.svg") if not p.name.startswith("sphx_glr_")]
    assert len(arrays) == 3, "the pictures of arrays were not drawn"
