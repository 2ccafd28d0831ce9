"""A made-up performance, and a browser."""

from collections.abc import Iterator

import pytest
from made_up_episode import make_episode

from cadenza.episode import Episode
from headless import Browser


@pytest.fixture
def episode() -> Episode:
    return make_episode()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()
