"""For all tests."""

import hashlib
import os
from pathlib import Path

import pytest

# Processes of tests share the cores; threads of linear algebra would wait for each other there.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import cadenza  # before any test imports NumPy, and so as commands do

# JAX compiles many programs here, each of which runs for moments: every one once, into a folder
# that all tests on such a processor share, also later ones, and without optimizing it.
COMPILED = "JAX_COMPILATION_CACHE_DIR"
FOR_JAX = {
    "JAX_COMPILATION_CACHE_MAX_SIZE": str(2**26),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "true",
}


def pytest_configure(config: pytest.Config) -> None:
    """Processes of xdist inherit the folder from the one that starts them."""
    if COMPILED not in os.environ and config.pluginmanager.has_plugin("cacheprovider"):
        about = Path("/proc/cpuinfo").read_text()
        processor = hashlib.sha256(about[about.find("flags") :].partition("\n")[0].encode())
        folder = config.cache.mkdir(f"jax-{processor.hexdigest()[:8]}")
        os.environ |= {COMPILED: str(folder), **FOR_JAX}
        config.add_cleanup(lambda: os.environ.pop(COMPILED))


@pytest.fixture(autouse=True, scope="session")
def user_and_machine(tmp_path_factory):
    """What whoever runs the tests has imported plays no part in them, nor have they many cores.

    Agents take one thread where a test gives no number, and then start no process for a hand.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CADENZA_DATA", str(tmp_path_factory.mktemp("data")))
        patch.setattr("cadenza.sim.threads.available_cores", lambda: 1)
        yield


@pytest.fixture(autouse=True, scope="session")
def engraves_here():
    """Pages engrave their scores in this process: to start another takes longer than to engrave."""
    from cadenza.report.engraving import engraving_of

    with pytest.MonkeyPatch.context() as patch:
        name = "cadenza.report.performance_page.engraving_within"
        patch.setattr(name, lambda _, score: engraving_of(score))
        yield


@pytest.fixture(scope="session")
def scene():
    """Both Shadow Hands at a piano; nobody changes it."""
    from cadenza.scene.scene import build_scene

    return build_scene()


@pytest.fixture(scope="session")
def right_hand():
    """The right one alone."""
    from cadenza.scene.scene import build_scene

    return build_scene(cadenza.SceneConfig(hands="right"))


LONGEST = (  # files that take tens of seconds, the longest first
    "test_practice.py",
    "test_readme.py",
    "test_planner.py",
    "test_training.py",
    "test_cli_train.py",
    "test_generalist.py",
    "test_exports.py",
    "test_cli_agents.py",
    "test_cli.py",
    "test_learner.py",
    "test_droq.py",
    "test_collecting.py",
    "test_benchmark.py",
    "test_server.py",
    "test_without_extras.py",  # a single test, which would be the last of all
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that take long begin first, so that several processes end at about one time."""
    last = len(LONGEST)
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.name, last))
