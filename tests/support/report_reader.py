"""Someone who reads a report in a browser, and what they see of it."""

import re

from playwright.sync_api import BrowserContext

PATIENCE = 30_000  # milliseconds, where nothing is slow but the machine may be


class Reader:
    """Someone who opens pages and writes down what goes wrong meanwhile."""

    def __init__(self, browser, folder):
        self.browser = browser
        self.folder = folder
        self.contexts: list[BrowserContext] = []
        self.complaints: list[str] = []
        self.requests: list[str] = []

    def read(self, text, **options):
        file = self.folder / f"report-{len(self.contexts)}.html"
        file.write_text(text, encoding="utf-8")
        self.contexts.append(self.browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options}))
        self.contexts[-1].set_default_timeout(PATIENCE)
        tab = self.contexts[-1].new_page()
        tab.on("console", lambda message: self.complaints.append(message.text))
        tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        tab.on("request", lambda request: self.requests.append(request.url))
        tab.goto(file.as_uri())
        return tab


def choose(tab, *, dataset="", **labels):
    if dataset:
        tab.get_by_role("tab", name=dataset, exact=True).click()
    for name, label in labels.items():
        options = tab.locator(f"#{name.replace('_', '-')} option").all_text_contents()
        (chosen,) = [option for option in options if option == label or option.startswith(f"{label} (")]
        tab.locator(f"#{name.replace('_', '-')}").select_option(label=chosen)


def listed(tab):
    """The queries in the list, in its order."""
    return [int(text) for text in tab.locator("#queries > li").evaluate_all("all => all.map(e => e.dataset.query)")]


def current(tab):
    return int(tab.locator("#queries > .current").get_attribute("data-query") or "-1")


def focused(tab):
    return str(tab.evaluate("document.activeElement.id"))


def colours(row):
    """The colour in the middle of each frame of a row, decoded by the browser."""
    decode = """async (images) => Promise.all(images.map(async (image) => {
        await image.decode();
        const canvas = document.createElement("canvas");
        [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
        const context = canvas.getContext("2d");
        context.drawImage(image, 0, 0);
        return [...context.getImageData(canvas.width >> 1, canvas.height >> 1, 1, 1).data].slice(0, 3);
    }))"""
    return [tuple(colour) for colour in row.locator("img").evaluate_all(decode)]


def queries_of(path):
    runs = re.findall(r"M(\d+) 100h(\d+)v", path)
    return {query for first, length in runs for query in range(int(first), int(first) + int(length))}


def widest(tab):
    return int(tab.evaluate("Math.max(document.documentElement.scrollWidth, document.body.scrollWidth)"))
