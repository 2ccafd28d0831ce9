"""For all tests."""

import pytest

import cadenza  # noqa: F401 - before any test imports NumPy, and so as commands do


@pytest.fixture(autouse=True, scope="session")
def no_data_of_the_user(tmp_path_factory):
    """What whoever runs the tests has imported plays no part in them."""
    patch = pytest.MonkeyPatch()
    patch.setenv("CADENZA_DATA", str(tmp_path_factory.mktemp("data")))
    yield
    patch.undo()


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
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that take long begin first, so that several processes end at about one time."""
    last = len(LONGEST)
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.name, last))
