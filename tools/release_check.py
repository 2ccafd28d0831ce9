"""Checks that a release can go out: `make release-check`.

python tools/release_check.py [STEP ...]

Each step is told with its time. All others are carried out even if one fails; the exit status is 1
then. It needs git, make and uv, nothing else that is installed, and half an hour, most of which are
the tests in a fresh clone.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from urllib.parse import urlsplit

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
MAX_OF_A_FILE = 2 * 2**20  # bytes of one file in the wheel: networks take up to 1.4 million
MAX_OF_THE_WHEEL = 10 * 2**20  # bytes
LICENCES = ("LICENSE", "NOTICE", "three.LICENSE.txt", "uplot.LICENSE.txt", "mediabunny.LICENSE.txt")
SMOKE = """
import importlib, pkgutil
import gymnasium, cadenza, cadenza.studio
env = gymnasium.make("cadenza/OdeToJoy-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
for module in pkgutil.iter_modules(cadenza.studio.__path__, "cadenza.studio."):
    importlib.import_module(module.name)
"""
LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ +(.+)$", re.MULTILINE)
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)


class ReleaseError(Exception):
    """What stands in the way of a release; steps raise it."""


# What the repository says


def clean() -> None:
    """Checks that everything is committed."""
    if changed := output("git", "status", "--porcelain"):
        raise ReleaseError(f"not committed: {', '.join(line[3:] for line in changed.splitlines())}")


def version() -> str:
    """Returns the version of the package."""
    return found(r'^__version__ = "(.+)"$', "src/cadenza/__init__.py")


def versions() -> None:
    """Checks that package, citation and changelog tell one version."""
    cited = found(r"^version: (.+)$", "CITATION.cff")
    logged = found(r"^## ([\d.]+)", "CHANGELOG.md")
    if not version() == cited == logged:
        raise ReleaseError(f"package {version()}, CITATION.cff {cited}, CHANGELOG.md {logged}")


def dated() -> None:
    """Checks that changelog and citation tell the same date."""
    cited = found(r"^date-released: (.+)$", "CITATION.cff")
    logged = found(rf"^## {re.escape(version())},? (.+)$", "CHANGELOG.md")
    if cited != logged:
        raise ReleaseError(f"CITATION.cff is dated {cited}, CHANGELOG.md {logged}")


def links() -> None:
    """Checks that the links of all pages lead somewhere; those to other sites, how they look."""
    pages = [ROOT / name for name in output("git", "ls-files", "*.md").splitlines()]
    if broken := [f"{page.relative_to(ROOT)}: {to}" for page in pages for to in broken_links(page)]:
        raise ReleaseError("; ".join(broken))


def broken_links(page: Path) -> Iterator[str]:
    """Yields links of a page to files or headings that are not there, and what is no address."""
    for target in LINK.findall(CODE.sub("", page.read_text("utf-8"))):
        parts = urlsplit(target)
        if parts.scheme:
            if parts.scheme not in ("https", "http", "mailto") or not (parts.netloc or parts.path):
                yield target
            continue
        to = page.parent / parts.path if parts.path else page
        if not to.exists() or (parts.fragment and parts.fragment not in anchors(to)):
            yield target


@cache
def anchors(page: Path) -> set[str]:
    """Returns the names of a page's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title) for title in HEADING.findall(text))
    return {re.sub(r"[^\w -]", "", title.strip().lower()).replace(" ", "-") for title in titles}


def licences() -> None:
    """Checks that docs/licences.md lists what is installed, and that nothing forbids its use."""
    run("make", "licences")
    if output("git", "diff", "--name-only", "docs/licences.md"):
        raise ReleaseError("docs/licences.md has changed: look at the difference, and commit it")


# What is built


@cache
def built() -> tuple[Path, Path]:
    """Builds the wheel and the sdist; returns where they are."""
    folder = fresh()
    run("uv", "build", "--quiet", "--out-dir", folder)
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


def wheel() -> None:
    """Checks that the wheel holds the package and the licences, and nothing large."""
    with zipfile.ZipFile(built()[0]) as file:
        if wrong := list(problems_of_wheel({i.filename: i.file_size for i in file.infolist()})):
            raise ReleaseError("; ".join(wrong))


def problems_of_wheel(sizes: dict[str, int]) -> Iterator[str]:
    """Yields what is wrong with a wheel that has files of these sizes [bytes]."""
    about = f"cadenza-{version()}.dist-info/"
    for name, size in sizes.items():
        if not name.startswith(("cadenza/", "cadenza_command.py", about)):
            yield f"{name} is not of the package"
        if re.search(r"__pycache__|\.pyc$|(^|/)tests?/|/\.", name):
            yield f"{name} is of no use to anyone"
        if size > MAX_OF_A_FILE:
            yield f"{name} takes {size:,} bytes"
    if sum(sizes.values()) > MAX_OF_THE_WHEEL:
        yield f"it takes {sum(sizes.values()):,} bytes"
    there = {name.rpartition("/")[2] for name in sizes if name.startswith(f"{about}licenses/")}
    yield from (f"{name} is missing" for name in LICENCES if name not in there)
    tracked = output("git", "ls-files", "src").splitlines()
    missing = {name.removeprefix("src/") for name in tracked} - sizes.keys()
    yield from (f"{name} is missing" for name in sorted(missing))


def sdist() -> None:
    """Checks that the sdist holds just what is committed."""
    with tarfile.open(built()[1]) as file:
        names = {name.partition("/")[2] for name in file.getnames()} - {"PKG-INFO"}
    if differ := names ^ set(output("git", "ls-files").splitlines()):
        raise ReleaseError(f"the sdist and the repository differ: {', '.join(sorted(differ))}")


def installs() -> None:
    """Tries the wheel on every Python, with the newest and the oldest libraries; and the sdist."""
    wheel, sdist = built()
    for python in PYTHONS:
        for resolution in ("highest", "lowest-direct"):
            try_package(wheel, python, resolution)
    try_package(sdist, PYTHONS[0], "highest")


def try_package(package: Path, python: str, resolution: str) -> None:
    """Installs a package into a fresh environment, has it play, and imports what is in it."""
    folder = fresh()
    tell(f"  {package.suffix} on Python {python}, {resolution} versions of what it needs")
    run("uv", "venv", "--quiet", "--python", interpreter(python), folder / "venv")
    bounds = ["--resolution", resolution, "--requirements", ROOT / "pyproject.toml"]
    install = ["uv", "pip", "install", "--quiet", "--python", folder / "venv"]
    run(*install, *bounds, "--extra", "studio")
    run(*install, "--no-deps", package)
    cadenza = folder / "venv" / "bin" / "cadenza"
    run(cadenza, "play", "TwinkleTwinkleLittleStar", "--first-seconds", "2", at=folder)
    if not (folder / "played/TwinkleTwinkleLittleStar/planner/report.html").exists():
        raise ReleaseError(f"Python {python}, {resolution}: nothing was played")
    run(cadenza, "info", at=folder)
    run(folder / "venv" / "bin" / "python", "-c", SMOKE, at=folder)


def interpreter(python: str) -> str:
    """Returns the path of a Python that pyenv has, or its version, for uv to find or to fetch."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    return str(next(pyenv.glob(f"versions/{python}.*/bin/python"), python))


# What the README tells people to run


def uvx() -> None:
    """Runs the line of the README that plays in a clone that has been set up for nothing."""
    folder = fresh() / "cadenza"
    run("git", "clone", "--quiet", ROOT, folder)
    run("uvx", *shlex.split(found(r"^uvx (.+)$", "README.md")), at=folder)


def clone() -> None:
    """Runs both commands of the README in a fresh clone."""
    folder = fresh() / "cadenza"
    run("git", "clone", "--quiet", ROOT, folder)
    for target in ("play", "test"):
        tell(f"  make {target}")
        run("make", target, at=folder)


STEPS: tuple[Callable[[], None], ...] = (
    clean,
    versions,
    dated,
    links,
    licences,
    wheel,
    sdist,
    uvx,
    installs,
    clone,
)


@cache
def scratch() -> TemporaryDirectory[str]:
    """Makes the folder of all that is tried; it goes when Python ends."""
    return TemporaryDirectory(prefix="cadenza-release-")


def fresh() -> Path:
    """Returns an empty folder."""
    return Path(mkdtemp(dir=scratch().name))


def found(pattern: str, name: str) -> str:
    """Returns what a pattern finds first in a file of the repository."""
    match = re.search(pattern, (ROOT / name).read_text("utf-8"), re.MULTILINE)
    if match is None:
        raise ReleaseError(f"{name}: has no line like {pattern}")
    return match[1]


def run(*command: str | Path, at: Path = ROOT) -> str:
    """Runs a command in a folder, without what Python would import besides; returns its output."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    try:
        done = subprocess.run(command, cwd=at, env=env, capture_output=True, text=True)
    except FileNotFoundError as error:
        raise ReleaseError(f"{command[0]}: not installed") from error
    if done.returncode:
        last = "\n".join((done.stdout + done.stderr).splitlines()[-20:])
        raise ReleaseError(
            f"{shlex.join(map(str, command))}: exit status {done.returncode}\n{last}"
        )
    return done.stdout


def output(*command: str) -> str:
    """Returns what a command prints, without the spaces at its end."""
    return run(*command).rstrip()


def tell(what: str) -> None:
    print(what, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="release_check", description=__doc__.partition("\n")[0])
    names = {step.__name__: step for step in STEPS}
    parser.add_argument("steps", nargs="*", metavar="STEP", help=f"{', '.join(names)}; or all")
    wanted = parser.parse_args().steps or list(names)
    if unknown := set(wanted) - names.keys():
        parser.error(f"no step {unknown.pop()}")
    failed = []
    for name in wanted:
        begun, said = time.monotonic(), "ok"
        tell(f"{name}: {(names[name].__doc__ or '').partition(chr(10))[0]}")
        try:
            names[name]()
        except ReleaseError as problem:
            failed.append(name)
            said = f"FAILED: {problem}"
        tell(f"{name}: {said} ({time.monotonic() - begun:.1f} s)")
    tell(f"failed: {', '.join(failed)}" if failed else "nothing stands in the way")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
