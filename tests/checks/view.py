"""Uses the page of `csi5300 view` as people do. Arguments: browser, addresses of captures, log and node, the page as one file, the report of `doctor --accept`, folder for pictures or "", the node's process."""
import os, re, signal, socket, sys, time, urllib.error, urllib.request
from playwright.sync_api import expect, sync_playwright

browser_path, captures, log, node, file, report, pictures, process = sys.argv[1:9]
# For a busy machine.
LONG_MS = 300_000
expect.set_options(timeout=LONG_MS)


class Watched:
    """A page that may only request its own server, and must not print to its console."""

    def __init__(self, browser, url, own, **options):
        self.context = browser.new_context(**options)
        self.page = self.context.new_page()
        self.page.set_default_timeout(LONG_MS)
        self.wrong = []
        self.page.on("console", lambda said: self.wrong.append(said.text) if said.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on("request", lambda request: None if request.url.startswith((own, "data:", "blob:")) else self.wrong.append(request.url))
        self.page.goto(url)

    def picture(self, name):
        if pictures:
            self.page.screenshot(path=f"{pictures}/{name}.png")

    def close(self):
        assert not self.wrong, self.wrong
        self.context.close()


def painted(page, canvas):
    """Number of colours in a canvas: a picture has many."""
    return page.evaluate(
        """(canvas) => { const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        const seen = new Set(); for (let k = 0; k < data.length; k += 4) seen.add(data[k] << 16 | data[k + 1] << 8 | data[k + 2]); return seen.size; }""",
        canvas.element_handle(),
    )


def coloured(page, canvas):
    """Pixels of a canvas that are not grey: lines have colours, axes do not."""
    return page.evaluate(
        """(canvas) => { const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        let seen = 0; for (let k = 0; k < data.length; k += 4) seen += data[k + 3] > 0 && Math.max(data[k], data[k + 1], data[k + 2]) - Math.min(data[k], data[k + 1], data[k + 2]) > 60; return seen; }""",
        canvas.element_handle(),
    )


def rows(page):
    return page.locator("#list tbody tr")


def table(page):
    expect(page.locator("#state")).to_have_text("3 links")
    expect(rows(page)).to_have_count(3)
    expect(rows(page).nth(2)).to_contain_text("csi_rx_")
    # Sorted by the size of the other program's errors, the largest first; links without one come last.
    page.locator("th button", has_text="toolbox").click()
    expect(page.locator("th[aria-sort=descending]")).to_have_text("toolbox")
    expect(rows(page).first).to_contain_text("LOS_B")
    page.keyboard.press("/")
    page.keyboard.type("toolbox<7")
    expect(rows(page)).to_have_count(1)
    expect(rows(page).first).to_contain_text("LOS_A")
    page.keyboard.press("Escape")
    page.locator("input[type=search]").fill("los_b")
    expect(page.locator("#list .head p")).to_have_text("1 of 3 links")
    page.locator("input[type=search]").fill("")
    page.locator("th button", has_text="link").click()
    expect(rows(page).first).to_contain_text("LOS_A")


def link(page):
    rows(page).first.click()
    expect(page.locator(".answer")).to_contain_text(re.compile(r"-?\d+\.\d° ± \d"))
    expect(page.locator(".answer")).to_contain_text("truth")
    expect(rows(page).first).to_have_attribute("aria-selected", "true")
    assert painted(page, page.locator("canvas.map")) > 20, "no map"
    profile = page.locator("section", has_text="Where the signal comes from").locator("canvas")
    assert painted(page, profile.first) > 20, "no profile"
    # The bars are those of the answer: 95 % is not twice 68 %.
    expect(page.locator(".key", has_text="answer")).to_contain_text(re.compile(r"± (\d+\.\d\d)° \(68 %\), ± \d+\.\d\d° \(95 %\)"))
    cells = page.locator("th", has_text="probability share").locator("xpath=ancestor::table").locator("tbody tr").first.locator("td")
    assert "–" not in cells.all_text_contents(), "a column of the candidates that has no values"
    page.get_by_role("button", name="near the answer").click()
    page.get_by_role("button", name="one direction").click()
    expect(page.get_by_role("button", name="one direction")).to_have_attribute("aria-pressed", "true")


def heat(page):
    """The heat map and the time lines: zoom, pan, read values."""
    readout = page.locator("p.readout")
    expect(readout).to_contain_text("amplitude from")
    chart = page.locator(".plot", has_text="CSI over time and subcarrier")
    assert painted(page, chart.locator("canvas")) > 50, "no heat map"
    for name in ("records per second", "RSSI of antennas", "under the cursor"):
        assert coloured(page, page.locator(".plot", has_text=name).locator("canvas")) > 300, name
    chart.scroll_into_view_if_needed()
    over = chart.locator(".u-over")
    box = over.bounding_box()
    at = lambda x, y: (box["x"] + x * box["width"], box["y"] + y * box["height"])
    page.mouse.move(*at(0.75, 0.5))
    seconds = lambda: float(re.search(r"; (-?[\d.]+) s", readout.text_content()).group(1))
    expect(readout).to_contain_text(re.compile("subcarrier -?1[;:]"))
    before = seconds()
    page.mouse.move(*at(0.6, 0.5))
    page.mouse.down()
    page.mouse.move(*at(0.9, 0.5), steps=4)
    page.mouse.up()
    # The same position is now another time.
    page.mouse.move(*at(0.1, 0.5))
    whole = before / 0.75
    page.wait_for_function(f"() => Math.abs(parseFloat(/; (-?[\\d.]+) s/.exec(document.querySelector('p.readout').textContent)[1]) - {0.63 * whole}) < {0.03 * whole}")
    page.keyboard.press("0")
    page.mouse.move(*at(0.25, 0.5))
    page.wait_for_function(f"() => Math.abs(parseFloat(/; (-?[\\d.]+) s/.exec(document.querySelector('p.readout').textContent)[1]) - {0.25 * whole}) < {0.02 * whole}")
    page.keyboard.press("+")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("a")
    expect(readout).to_contain_text("phase from")
    page.keyboard.press("0")
    page.get_by_role("button", name="phase", exact=True).click()
    expect(readout).to_contain_text("amplitude from")


def keys(page):
    page.keyboard.press("ArrowDown")
    expect(rows(page).nth(1)).to_have_attribute("aria-selected", "true")
    expect(page.locator("h2").first).to_contain_text("LOS_B")
    page.keyboard.press("ArrowDown")
    expect(page.locator(".answer.bad")).to_contain_text("csi_rx_")
    page.keyboard.press("?")
    expect(page.locator("dialog")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator("dialog")).not_to_be_visible()
    theme = page.locator("html").get_attribute("data-theme")
    page.keyboard.press("t")
    expect(page.locator("html")).not_to_have_attribute("data-theme", theme)
    page.keyboard.press("t")
    page.keyboard.press("Escape")
    expect(page.locator("h2").first).to_have_text("All links")


def sets(page):
    chart = page.locator("section", has_text="Errors by set").locator("canvas")
    assert painted(page, chart.first) > 5, "no distribution"
    expect(page.locator(".key", has_text="LOS_A, toolbox")).to_be_visible()
    line = page.locator("#shown tr", has_text="LOS_B")
    expect(line).to_contain_text("12.50")


def tabs(browser, url, words):
    """More tabs of one browser than it opens connections to a server."""
    context = browser.new_context()
    for _ in range(8):
        page = context.new_page()
        page.goto(url)
        expect(page.locator("#state")).to_have_text(words)
    context.close()


def refused(url):
    """What other web pages and programs could request from this server."""
    host = re.match(r"http://([\d.]+):(\d+)/", url)

    def status(path="", headers={}, method="GET"):
        try:
            return urllib.request.urlopen(urllib.request.Request(url + path, headers=headers, method=method)).status
        except urllib.error.HTTPError as error:
            return error.code

    assert status() == 200
    assert status(headers={"Host": "evil.example"}) == 403
    assert status(headers={"Origin": "http://evil.example"}) == 403
    assert status("data/rows", {"Sec-Fetch-Site": "cross-site"}) == 403
    assert status(method="POST") == 405
    assert status("data/log/0/../../../etc/passwd") == 404
    assert status("data/log/99") == 404 and status("data/log/0/levels?columns=x") == 400
    head = urllib.request.urlopen(url).headers
    assert "default-src 'none'" in head["content-security-policy"] and head["x-content-type-options"] == "nosniff"
    # Idle connections take places and release them again.
    idle = [socket.create_connection(host.groups()) for _ in range(100)]
    for one in idle:
        one.close()
    end = time.monotonic() + LONG_MS / 1000
    while True:
        try:
            assert status() == 200
            return
        except OSError as error:
            assert time.monotonic() < end, f"no answer after idle connections went: {error}"
            time.sleep(0.1)


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
    wide = {"viewport": {"width": 1440, "height": 1000}}
    seen = Watched(browser, node, node, **wide)
    expect(seen.page.locator("h2").first).to_have_text("burger")
    peer = seen.page.locator("tbody tr", has_text="tx")
    expect(peer).to_contain_text(re.compile(r"\d+\.\d° ± \d"))
    assert painted(seen.page, seen.page.locator("canvas.map")) > 10, "no map"
    # The team's graph places the peer.
    expect(seen.page.locator("canvas.map")).to_have_attribute("aria-label", re.compile(", tx"))
    first = seen.page.locator("#shown p").first.text_content()
    expect(seen.page.locator("#shown p").first).not_to_have_text(first)
    seen.picture("view-node")
    # One that hangs is no live one.
    expect(seen.page.locator("#state")).to_have_text("live")
    os.kill(int(process), signal.SIGSTOP)
    expect(seen.page.locator("#state")).to_have_text("no word from the node: it ended, or hangs")
    os.kill(int(process), signal.SIGCONT)
    expect(seen.page.locator("#state")).to_have_text("live")
    seen.close()
    seen = Watched(browser, captures, captures, **wide)
    table(seen.page)
    sets(seen.page)
    seen.picture("view-sets")
    link(seen.page)
    seen.picture("view-link")
    heat(seen.page)
    keys(seen.page)
    seen.close()
    tabs(browser, captures, "3 links")
    tabs(browser, log, "2 logs")
    refused(captures)

    for name, theme, size in (("dark", "dark", (1440, 1000)), ("tablet", "light", (1024, 768)), ("upright", "dark", (768, 1024))):
        seen = Watched(browser, captures + "#link=0", captures, viewport={"width": size[0], "height": size[1]}, color_scheme=theme, has_touch=name != "dark")
        expect(seen.page.locator(".answer")).to_contain_text("truth")
        expect(seen.page.locator("html")).to_have_attribute("data-theme", theme)
        wide_as_page = seen.page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
        assert wide_as_page, f"{name}: the page is wider than its window"
        expect(seen.page.locator("p.readout")).to_contain_text("amplitude from")
        seen.picture(f"view-{name}")
        seen.close()

    seen = Watched(browser, "file://" + file, "file://", **wide)
    table(seen.page)
    sets(seen.page)
    link(seen.page)
    heat(seen.page)
    keys(seen.page)
    seen.close()

    seen = Watched(browser, log, log, **wide)
    expect(seen.page.locator("p.readout")).to_contain_text("amplitude from")
    expect(seen.page.locator("#shown")).to_contain_text("281 records")
    head, places = seen.page.locator("#list th").first.bounding_box(), [row.bounding_box() for row in rows(seen.page).all()]
    assert len(places) > 1 and all(place["y"] > head["y"] + head["height"] - 2 for place in places), "the head hides a row"
    heat(seen.page)
    seen.picture("view-log")
    seen.close()

    seen = Watched(browser, "file://" + report, "file://", **wide)
    expect(seen.page.locator("td.fails").first).to_have_text("FAILS")
    expect(seen.page.locator("tr", has_text="card.clock").first).to_contain_text("Likely: the driver was reloaded")
    expect(seen.page.locator("svg")).to_have_count(5)
    assert seen.page.locator("svg circle").count() > 500
    assert seen.page.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), "the report is wider than its window"
    seen.picture("accept")
    seen.close()

    browser.close()
print("captures, link, log, node, the one file and the report: clicked through; nothing was fetched from elsewhere")
