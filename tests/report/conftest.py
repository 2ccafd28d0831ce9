"""A made-up performance, and a browser."""

import pytest
from made_up_episode import make_episode

from headless import Browser


@pytest.fixture
def episode():
    return make_episode()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()
