"""What the page does where something is not as usual: a daemon that is busy, a value that is bad, a clock that was set back."""

import re
from datetime import datetime, timezone

from playwright.sync_api import expect

from walk import check

BUSY = {"type": "urn:stictiond:problem:busy", "detail": "too much at once"}
SAMPLES = re.compile(r"/api/v1/loops/FIC102/samples\?")
HEALTH = "**/api/v1/healthz"

# Live samples come from the test alone, which hands them to the newest stream by `say`; what is done every half minute is done at once.
SCRIPT = """(() => {
    const Real = window.EventSource, timer = window.setInterval;
    window.streams = [];
    window.EventSource = Object.assign(function (url) {
        if (!url.endsWith("/live")) return new Real(url);
        const own = Object.assign(new EventTarget(), { readyState: 1, close() { this.readyState = 2; } });
        window.streams.push(own);
        return own;
    }, { CLOSED: 2 });
    window.say = (tags) => void window.streams.at(-1).dispatchEvent(new MessageEvent("samples", { data: JSON.stringify(tags) }));
    window.setInterval = (act, milliseconds) => timer(act, milliseconds === 30000 ? 200 : milliseconds);
})()"""


def refuse_once(page, pattern):
    page.route(pattern, lambda route: route.fulfill(status=503, json=BUSY), times=1)


def refused(walk, what):
    """The browser itself reports the one answer that was refused."""
    check(len(walk.faults) == 1 and "503" in walk.faults[0], what)
    walk.faults.clear()


def changes(walk):
    """A change whose fetch fails, and one of a loop that was not among those held."""
    page = walk.open(1440, 900)
    walk.go()
    tile = page.locator(".tile[data-id=FIC103]")
    expect(tile).to_have_attribute("data-kind", "waiting")
    expect(page.locator("#link")).to_have_text("live")
    refuse_once(page, re.compile(r"/api/v1/loops/FIC103$"))
    diagnose = f"{walk.base}/api/v1/loops/FIC103/diagnosis?wait_s=0"
    page.request.post(diagnose)
    expect(tile).to_have_attribute("data-kind", "unacknowledged", timeout=60_000)
    refused(walk, "a change whose fetch failed is asked for again")
    check("diagnosed 2026-01-01 " in tile.get_attribute("title"), "a tile says when its loop was diagnosed")
    expect(page.locator("#alarm-count")).to_have_text("4")

    def without(route):
        answer = route.fetch().json()
        answer["items"] = [item for item in answer["items"] if item["id"] != "FIC103"]
        route.fulfill(json=answer)

    page.route(re.compile(r"/api/v1/loops\?"), without)
    page.reload()
    expect(page.locator(".tile")).to_have_count(5)
    expect(page.locator("#link")).to_have_text("live")
    page.request.post(diagnose)
    expect(tile).to_have_attribute("data-kind", "unacknowledged", timeout=60_000)
    print("ok: a loop that was not held comes with its alarm")


def tag(name, t, value, quality="good"):
    time = datetime.fromtimestamp(t, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {"tag": name, "unit": "%", "found": 1, "time": [time], "value": [value], "quality": [quality]}


def live(walk):
    """The first samples are refused; then a value gets bad, and the clock is set back."""
    page = walk.open(1440, 1000)
    page.add_init_script(SCRIPT)
    refuse_once(page, SAMPLES)
    with page.expect_request(re.compile(r"/alarms/history\?.*kind=stiction")):
        page.goto(f"{walk.base}/#/loop/FIC102")
    expect(page.get_by_text("The trends cannot be fetched")).to_be_visible()
    expect(page.locator(".verdict strong")).to_contain_text("The valve sticks")
    frame = page.locator(".trend")
    expect(frame).to_have_attribute("data-newest", re.compile(r"^\d+"))
    expect(page.locator(".verdict strong")).to_contain_text("The valve sticks")
    check(page.evaluate("streams.map((own) => own.readyState)") == [2, 1], "of a trend that failed no stream is left")
    refused(walk, "a trend whose first samples were refused is begun again")

    age = page.locator(".verdict p span[title]")
    check(re.fullmatch(r"2026-01-01 \d\d:\d\d:\d\d", age.get_attribute("title")), "when it was diagnosed is told")
    expect(age).not_to_have_text(age.text_content())
    print("ok: how long ago that is grows")

    def say(*tags):
        page.evaluate("(tags) => say(tags)", tags)

    newest = int(float(frame.get_attribute("data-newest")))
    op = page.locator("[aria-label='Latest values'] [data-tag=op]")
    say(tag("op", newest + 2, None, "bad:timeout"))
    expect(op).to_have_class("bad")
    expect(op).to_contain_text("– % bad:timeout")
    say(tag("op", newest + 4, 42.0))
    expect(op).not_to_have_class("bad")
    expect(op).to_have_text("OP42 %")
    expect(frame).to_have_attribute("data-newest", str(newest + 4))
    print("ok: a value is shown with its own quality")

    then = newest - 600
    since = [tag(name, then, 41.0) for name in ("op", "pv", "sp")]
    page.route(SAMPLES, lambda route: route.fulfill(json={"loop": "FIC102", "from": None, "to": None, "tags": since}))
    say(*since)
    expect(frame).to_have_attribute("data-newest", str(then))
    say(tag("op", then + 2, 43.0))
    expect(frame).to_have_attribute("data-newest", str(then + 2))
    print("ok: the trend goes on where the clock was set back to")


def colours(walk):
    """The colours change before the first samples are there."""
    page = walk.open(1440, 1000)
    held = []
    page.route(SAMPLES, lambda route: held.append(route))
    page.goto(f"{walk.base}/#/loop/FIC102")
    expect(page.locator("#trend .ranges")).to_be_visible()
    page.locator("#theme").click()
    for route in held:
        route.continue_()
    page.unroute(SAMPLES)
    expect(page.locator("#trend .u-cursor-pt")).to_have_count(3)
    print("ok: PV, SP and OP are drawn all the same")


def no_unit(walk):
    page = walk.open(1440, 900)
    walk.go("fleet?group=")
    only = page.get_by_role("button", name="only no unit")
    expect(page.get_by_text("No loop is like this.")).to_be_visible()
    only.click()
    expect(page.get_by_text("6 of 6 loops, worst first")).to_be_visible()
    expect(only).to_be_hidden()
    print("ok: loops without a unit are a choice of their own")


def list_again(walk):
    """The list of the fleet's page is refused once; what is done every five seconds is done at once."""
    page = walk.open(1440, 900)
    page.add_init_script("(() => { const timer = window.setInterval; window.setInterval = (act, milliseconds) => timer(act, milliseconds === 5000 ? 200 : milliseconds); })()")
    refuse_once(page, re.compile(r"/api/v1/loops\?limit=50&q=fic"))
    page.goto(f"{walk.base}/#/fleet?q=fic")
    expect(page.get_by_text("4 of 4 loops, worst first")).to_be_visible()
    refused(walk, "a list that was refused is asked for again")


def store(walk):
    """A store that is damaged: what is said of it above every view, in both colours and on a phone; then it only fails, then it works."""
    for name, width, height, scheme in [("light", 1440, 900, "light"), ("dark", 1440, 900, "dark"), ("phone", 390, 844, "light")]:
        page = walk.open(width, height, scheme)
        for route in ("", "alarms"):
            walk.go(route)
            said = page.get_by_role("alert")
            expect(said).to_be_visible()
            expect(said).to_contain_text("The store is damaged: nothing is written to it.")
            expect(said).to_contain_text("page 7 of <img src=x onerror=alert(1)> is not what was written")
            expect(said).to_contain_text("3 records of alarms and models are lost.")
            expect(said).to_contain_text("stictiond store check --repair")
        check(page.locator("#store img").count() == 0, "what is said of the store is text")
        walk.axe(f"a damaged store, {name}")
        walk.shot(f"store-{name}")
        if width < 500:
            walk.fits("a damaged store on a phone")

    def answers(**other):
        def patched(route):
            answer = route.fetch().json()
            answer["store"].update(other)
            route.fulfill(json=answer)

        page.unroute(HEALTH)
        page.route(HEALTH, patched)

    answers(damaged=False, reason="the disk is full", lost_states=0)
    expect(said).to_contain_text("The store fails: nothing is written to it.")
    expect(said).to_contain_text("the disk is full")
    expect(said).to_contain_text("Check that its disk is there and has room")
    expect(said).not_to_contain_text("--repair")
    answers(state="working", damaged=False, reason=None, since=None, lost_states=0)
    expect(page.locator("#store")).to_be_hidden()
    print("ok: it goes when the store works again")

    def recorded(**audit):
        def patched(route):
            answer = route.fetch().json()
            answer["store"].update(state="working", damaged=False, reason=None, since=None, lost_states=0)
            answer["audit"] = audit
            route.fulfill(json=answer)

        page.unroute(HEALTH)
        page.route(HEALTH, patched)

    recorded(state="failing", damaged=True, reason="audit log <img src=x onerror=alert(1)>.3: line 2: changed")
    expect(said).to_contain_text("The audit log is damaged: changes are refused.")
    expect(said).to_contain_text("audit log <img src=x onerror=alert(1)>.3: line 2: changed")
    expect(said).to_contain_text("stictiond audit renew")
    check(page.locator("#record img").count() == 0, "what is said of the audit log is text")
    walk.axe("a damaged audit log")
    recorded(state="failing", damaged=False, reason="the disk is full")
    expect(said).to_contain_text("Changes are refused: they cannot be put on record.")
    expect(said).not_to_contain_text("renew")
    recorded(state="working", damaged=False, reason=None)
    expect(page.locator("#record")).to_be_hidden()
    page.unroute(HEALTH)
    print("ok: a damaged audit log is told until it works again")


trouble = [changes, live, colours, no_unit, list_again]
