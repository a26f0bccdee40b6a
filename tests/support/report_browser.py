"""The browser that reads reports: fixtures of the tests that name this file in `pytest_plugins`."""

import os
import shutil

import pytest
from playwright.sync_api import expect, sync_playwright
from report_page import made_up_page
from report_reader import PATIENCE, Reader

ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
)


@pytest.fixture(scope="module")
def browser():
    chromium = shutil.which("chromium")
    if chromium is None:
        reason = "there is no chromium on this machine: its package brings it"
        if os.environ.get("VPRBENCH_INSIST_ON_CHROMIUM"):
            pytest.fail(reason)
        pytest.skip(reason)
    expect.set_options(timeout=PATIENCE)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS.split(), timeout=4 * PATIENCE)
        yield browser
        browser.close()


@pytest.fixture
def reader(browser, tmp_path):
    reader = Reader(browser, tmp_path)
    yield reader
    for context in reader.contexts:
        context.close()
    assert reader.complaints == []


@pytest.fixture
def tab(reader):
    return reader.read(made_up_page())
