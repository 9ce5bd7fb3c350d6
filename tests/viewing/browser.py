"""Pages in a headless Chromium: what they show, and that they neither complain nor reach for the network.

Playwright keeps an event loop running in the thread that it was started in, where no test could then call
`asyncio.run`. So it lives in a thread of its own, and `Page` passes on what a test asks of it.
"""

import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

ARGUMENTS = (
    "--no-sandbox",  # in a container there is none to be had
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
AT_HOME = ("file:", "data:", "blob:", "about:")
PATIENCE = 5_000  # ms for anything that a page is waited for


class Page:
    """A page as a test sees it."""

    def __init__(self, page, do):
        self._page, self._do = page, do
        self.complaints, self.requests = [], []
        page.set_default_timeout(PATIENCE)
        page.on("console", lambda message: self.complaints.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def open(self, address, scheme, width, height, motion):
        """Go to a page; in the browser's thread."""
        self.complaints, self.requests = [], []
        self._page.emulate_media(color_scheme=scheme, reduced_motion=motion)
        self._page.set_viewport_size({"width": width, "height": height})
        self._page.goto(address)

    def close(self):
        """Leave the page; in the browser's thread."""
        self._page.goto("about:blank")

    def prefer(self, scheme):
        """Have the reader's system change to light or dark."""
        self._do(lambda: self._page.emulate_media(color_scheme=scheme))

    def evaluate(self, script, argument=None):
        """The value of an expression, or what a function makes of the argument; promises are waited for."""
        return self._do(lambda: self._page.evaluate(script, argument))

    def wait(self, script, argument=None):
        """Wait until an expression, or what a function makes of the argument, is true.

        Asked again and again from here: Playwright's own way evaluates text in the page, which a page may forbid.
        """
        until = time.monotonic() + PATIENCE / 1000
        while not self.evaluate(script, argument):
            assert time.monotonic() < until, f"waited in vain for {script}"
            time.sleep(0.01)

    def in_frame(self, script):
        """The value of an expression in the page's first frame."""
        return self._do(lambda: self._page.frames[1].evaluate(script))

    def text(self, selector):
        """The text of the first element, as it is read."""
        return self._do(self._page.locator(selector).first.inner_text)

    def texts(self, selector):
        """The texts of all elements."""
        return self._do(lambda: self._page.locator(selector).all_inner_texts())

    def click(self, selector):
        """Click on an element."""
        self._do(self._page.locator(selector).first.click)

    def choose(self, selector, value):
        """Choose an option."""
        self._do(lambda: self._page.locator(selector).first.select_option(value))

    def press(self, key, times=1):
        """Press a key."""
        self._do(lambda: [self._page.keyboard.press(key) for _ in range(times)])

    def resize(self, width, height):
        """Give the window another size."""
        self._do(lambda: self._page.set_viewport_size({"width": width, "height": height}))

    def screenshot(self, path=None):
        """A PNG of the whole page."""
        return self._do(lambda: self._page.screenshot(path=path, full_page=True))

    @property
    def overflow(self):
        """px by which the page is wider than its window."""
        return self.evaluate("document.documentElement.scrollWidth - window.innerWidth")

    @property
    def strays(self):
        """Addresses that the page has asked for, but for its own file and what it holds."""
        return [url for url in self.requests if not url.startswith(AT_HOME)]


class Browser:
    """Opens pages, one after another in the same tab where it can: a new one takes longer than most tests."""

    def __init__(self, browser, do):
        self._browser, self._do, self._tabs = browser, do, {}

    @contextmanager
    def page(
        self, path, *, scheme="light", width=1200, height=800, motion="reduce", scale=1, scripts=True
    ):  # fmt: skip
        """Open a file; in the end it must not have complained, nor asked for anything from elsewhere.

        `scheme` is light or dark, `motion` reduce or no-preference, and `scale` device pixels a CSS pixel.
        """
        kind = scale, scripts
        if kind not in self._tabs:
            self._tabs[kind] = self._do(lambda: self._tab(*kind))
        page = self._tabs[kind]
        self._do(lambda: page.open(path.absolute().as_uri(), scheme, width, height, motion))
        yield page
        self._do(page.close)
        assert not page.complaints, page.complaints
        assert not page.strays, page.strays

    def _tab(self, scale, scripts):
        context = self._browser.new_context(device_scale_factor=scale, java_script_enabled=scripts)
        return Page(context.new_page(), self._do)


@contextmanager
def browser():
    """A headless Chromium; skips the test, and says why, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    executable = shutil.which("chromium") or shutil.which("chromium-browser")
    if executable is None:
        pytest.skip("chromium is not installed")
    with ThreadPoolExecutor(1, thread_name_prefix="browser") as thread:

        def do(action):
            return thread.submit(action).result()

        driver = do(playwright.sync_playwright().start)
        try:
            chromium = do(lambda: driver.chromium.launch(executable_path=executable, args=list(ARGUMENTS)))
            yield Browser(chromium, do)
            do(chromium.close)
        finally:
            do(driver.stop)
