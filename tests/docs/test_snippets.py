"""Every ```python block of every page runs, page by page, and prints what the page says it prints.

A ```text block that directly follows is the expected output; numbers may differ by a percent, as
other versions of the libraries round differently. A block that begins with a comment holding the
path of a file of the template is that file. A ```py block is another library's code: it runs where that
library is installed.
"""

import importlib.util
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEMPLATE = ROOT / "contrib" / "tracker-template"
MADE = ("generated", "gallery")  # by the build of the site
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    TEMPLATE / "README.md",
    *(p for p in sorted(ROOT.glob("docs/**/*.md")) if p.relative_to(ROOT).parts[1] not in MADE),
]
FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)\s*$")
END = "<end of block>"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


def blocks(page: Path) -> list[tuple[str, int, str]]:
    """Language, first line (from 1) and text of each fenced block."""
    found, inside, first, indent = [], "", 0, ""
    body: list[str] = []
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        fence = FENCE.match(line)
        if fence and not inside:
            inside, first, indent, body = (
                fence["language"] or "text",
                number + 1,
                fence["indent"],
                [],
            )
        elif inside and line.strip() == "```":
            found.append((inside, first, textwrap.dedent("\n".join(body))))
            inside = ""
        elif inside:
            body.append(line.removeprefix(indent))
    return found


def runs(page: Path, language: str) -> bool:
    """Whether blocks of this language are run: ours always, others' where all they import is there."""
    if language != "py":
        return language == "python"
    others = "\n".join(text for name, _, text in blocks(page) if name == "py")
    imported = set(re.findall(r"^(?:from|import) (\w+)", others, re.MULTILINE))
    return all(importlib.util.find_spec(name) for name in imported)


def script(page: Path) -> str:
    """The page's Python, every line at its own line number; each block ends by saying so."""
    lines: list[str] = []
    for language, first, text in blocks(page):
        if runs(page, language):
            lines += [""] * (first - 1 - len(lines))
            lines += text.splitlines()
            lines += [f"print({END!r})"]  # where the closing fence is
    return "\n".join(lines) + "\n"


def expected(page: Path) -> list[str | None]:
    """What each Python block should print, None where the page does not say."""
    source = page.read_text(encoding="utf-8").splitlines()
    found = blocks(page)
    answers: list[str | None] = []
    for k, (language, first, text) in enumerate(found):
        if not runs(page, language):
            continue
        answer = None
        if k + 1 < len(found) and found[k + 1][0] == "text":
            between = source[first + text.count("\n") + 1 : found[k + 1][1] - 2]
            answer = None if any(line.strip() for line in between) else found[k + 1][2]
        answers.append(answer)
    return answers


def same(got: str, wanted: str) -> bool:
    """Equal word for word, numbers to a percent, whitespace aside."""
    if NUMBER.sub("#", got).split() != NUMBER.sub("#", wanted).split():
        return False
    pairs = zip(NUMBER.findall(got), NUMBER.findall(wanted), strict=True)
    return all(float(a) == pytest.approx(float(b), rel=0.01, abs=1e-9) for a, b in pairs)


WITH_PYTHON = [page for page in PAGES if any(block[0] == "python" for block in blocks(page))]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_the_python_on_a_page_runs_and_prints_what_the_page_says(
    page: Path, tmp_path: Path
) -> None:
    # Compiled under the page's name, so that a traceback points at the page.
    runner = (
        "import sys, warnings, matplotlib; matplotlib.use('Agg'); warnings.simplefilter('error');"
        "sys.path.insert(0, sys.argv[2]);"
        "exec(compile(sys.stdin.read(), sys.argv[1], 'exec'), {'__name__': 'page'})"
    )
    command = [sys.executable, "-c", runner, str(page), str(TEMPLATE / "src")]
    done = subprocess.run(
        command, input=script(page), cwd=tmp_path, capture_output=True, text=True, check=False,
        encoding="utf-8",
    )  # fmt: skip
    assert done.returncode == 0, f"a snippet fails:\n{done.stderr}"
    printed = done.stdout.split(END + "\n")[:-1]
    for got, wanted in zip(printed, expected(page), strict=True):
        if wanted is not None:
            assert same(got, wanted), f"the page promises\n{wanted}\nbut its code prints\n{got}"


def test_the_template_s_page_shows_the_template_s_files() -> None:
    shown = 0
    for language, first, text in blocks(TEMPLATE / "README.md"):
        head, _, rest = text.partition("\n")
        path = re.fullmatch(r"# ((?:src|tests)/\S+)", head)
        if language == "python" and path:
            shown += 1
            actual = (TEMPLATE / path[1]).read_text(encoding="utf-8").strip()
            assert rest.strip() == actual, f"line {first}: the page's copy of {path[1]} is stale"
    assert shown == 3, "sensor, plugin module and conformance test are shown in full"


def test_the_readme_names_commands_that_exist() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    launcher = (ROOT / "x").read_text(encoding="utf-8")
    named = set(re.findall(r"\./x (\w+)", readme))
    assert {"demo", "test"} <= named
    assert all(f'"{name}":' in launcher for name in named), named


def test_links_between_pages_lead_somewhere() -> None:
    broken = []
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
            made = any(f"{name}/" in target for name in MADE)
            if not made and "://" not in target and not (page.parent / target).exists():
                broken.append(f"{page.relative_to(ROOT)}: {target}")
    assert not broken
