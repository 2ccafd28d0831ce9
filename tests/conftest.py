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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The file that takes longest begins first, so that several processes end at about one time."""
    items.sort(key=lambda item: item.path.name != "test_readme.py")
