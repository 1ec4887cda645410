"""Frames that a browser draws of a large net while it fires."""

import os
import shutil

from bench.display.firing_net import shown_firing
from bench.figures import Line
from bench.usage import cpu_s, descendants, program
from im_core.errors import ImError

BROWSER = ("--no-sandbox", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
_PATIENCE_MS = 180_000.0
_COUNT = """(seconds) => new Promise((done) => {
    const began = performance.now(), fired = document.getElementById("clock").textContent;
    let frames = 0;
    const count = (now) => {
        if (now - began < 1000 * seconds) { frames += 1; requestAnimationFrame(count); }
        else done([frames, 1000 * frames / (now - began), fired !== document.getElementById("clock").textContent]);
    };
    requestAnimationFrame(count);
})"""


def lines(seconds: float) -> list[Line]:
    """Frames a second, cell off, in a window of 1400 x 900.

    Raises:
        ImError: There is no browser, or it showed no firing.
    """
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        raise ImError("no browser is here to measure the page in: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with shown_firing(25, 40, 500.0) as server, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*BROWSER], timeout=_PATIENCE_MS)
        try:
            page = browser.new_page(viewport={"width": 1400, "height": 900})
            page.set_default_timeout(_PATIENCE_MS)
            page.goto(f"{server.url}#cell=0")
            page.wait_for_selector("#firings li")
            before = _cpu_s()
            count, rate, alive = page.evaluate(_COUNT, seconds)
            frame_ms = 1000.0 * sum(used - before.get(pid, 0.0) for pid, used in _cpu_s().items()) / count
        finally:
            browser.close()
    if not alive:
        raise ImError("the page has shown no firing while its frames were counted")
    return [
        Line("frames, 1,000 places, 500 firings/s", rate, "1/s", bar=30.0, at_least=True),
        Line("CPU time of a frame", frame_ms, "ms", None, "of all processes of the browser"),
    ]


def _cpu_s() -> dict[int, float]:
    """CPU time that each process of the browser has used [s]."""
    return {pid: cpu_s(pid) for pid in descendants(os.getpid()) if program(pid).startswith("chrom")}
