"""A real browser, without a window, for the tests of the page."""

import contextlib
import shutil

import pytest

from im_core import clock

PATIENCE_S = 180.0
LOADED = """[document.getElementById('link')?.textContent, document.readyState,
    performance.getEntriesByType('resource').map((one) => [one.name, one.responseStatus, Math.round(one.duration)])]"""
MISSING = "no browser is here to test the page in: apt-get install chromium (or chromium-browser) installs one"


@contextlib.contextmanager
def headless_browser():
    """Chromium; the test is skipped where none is installed."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip(MISSING)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path,
            args=["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"],
            timeout=1000 * PATIENCE_S,
        )
        try:
            yield browser
        finally:
            browser.close()


class Tab:
    """A tab that notes the errors of its scripts.

    Args:
        browser: The browser.
        url: Address that it opens.
        size: Width and height of the window [px].
        script: JavaScript that runs before those of the page.
    """

    def __init__(self, browser, url, size=(1400, 900), script="", **context):
        self._context = browser.new_context(viewport={"width": size[0], "height": size[1]}, **context)
        self.page = self._context.new_page()
        self.page.set_default_timeout(1000 * PATIENCE_S)
        self.errors = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.add_init_script(script)
        self.page.goto(url)

    def until(self, script, what):
        """Wait until an expression of JavaScript is true; asked from outside, since the page allows no evaluation."""
        deadline = clock.monotonic() + PATIENCE_S
        while not self.page.evaluate(script):
            if clock.monotonic() > deadline:
                found = f"errors of scripts: {self.errors}; of the page: {self.page.evaluate(LOADED)}"
                pytest.fail(f"waited for {what}, in vain; {found}")
            self.page.wait_for_timeout(50)

    def close(self):
        self._context.close()
        assert self.errors == []
