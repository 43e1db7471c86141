"""The fleet of a centre with 10,000 loops: a cell for each on the map, the way down to a loop, search, and the machines."""

import re
from collections import Counter

from playwright.sync_api import expect

from walk import check

ALL = 10_000
SITE, UNIT = "s03", "s03 / U17"
NASTY = "<img src=x onerror=alert(1)>"
STRANGE = "north / <b>U & 1</b> / 2?x=1"

# Notes what the latest drawing on a canvas has filled and outlined, and in which colour.
SCRIPT = """(() => {
    const own = CanvasRenderingContext2D.prototype, { scale } = own;
    own.scale = function (...by) {
        this.canvas.drawn = [];
        return scale.apply(this, by);
    };
    for (const [name, how, style] of [["fillRect", "full", "fillStyle"], ["strokeRect", "hollow", "strokeStyle"]]) {
        const real = own[name];
        own[name] = function (x, y, w, h) {
            this.canvas.drawn?.push({ how, colour: this[style], x, y, w, h });
            return real.call(this, x, y, w, h);
        };
    }
})()"""
# Loops are drawn as squares, sites are not.
CELLS = "(document.querySelector('canvas.map')?.drawn ?? []).filter((one) => one.w === one.h)"
# What the map says where the cells are, how many cells there are of each, and the middle of the last.
TOLD = f"""() => {{
    const canvas = document.querySelector("canvas.map"), {{ left, top }} = canvas.getBoundingClientRect(), told = {{}};
    for (const {{ x, y, w }} of {CELLS}) {{
        const at = {{ x: x + w / 2, y: y + w / 2 }};
        canvas.dispatchEvent(new MouseEvent("mousemove", {{ clientX: left + at.x, clientY: top + at.y }}));
        const [name] = canvas.title.split("\\n");
        told[name] = {{ n: (told[name]?.n ?? 0) + 1, at }};
    }}
    return told;
}}"""
# How many cells look alike, by the colours of the legend.
ALIKE = f"""() => {{
    const names = {{}}, alike = {{}}, paint = document.createElement("canvas").getContext("2d");
    for (const name of ["alarm", "warn", "faint", "rule"]) {{
        paint.fillStyle = getComputedStyle(document.querySelector(`.map-legend i.${{name}}`)).borderTopColor;
        names[paint.fillStyle] = name;
    }}
    for (const {{ how, colour }} of {CELLS}) alike[`${{how}} ${{names[colour]}}`] = (alike[`${{how}} ${{names[colour]}}`] ?? 0) + 1;
    return alike;
}}"""
# Cells that lie beside the map, and those on the place of another.
MISPLACED = f"""() => {{
    const {{ clientWidth, clientHeight }} = document.querySelector("canvas.map"), cells = {CELLS};
    const beside = cells.filter(({{ x, y, w, h }}) => !(w > 0 && x >= 0 && y >= 0 && x + w <= clientWidth + 0.01 && y + h <= clientHeight + 0.01));
    return [beside.length, cells.length - new Set(cells.map(({{ x, y }}) => `${{x.toFixed(2)}} ${{y.toFixed(2)}}`)).size];
}}"""
LOOKS = {"U": "full alarm", "A": "hollow alarm", "S": "full warn", "R": "hollow warn", "L": "hollow warn", "H": "full faint", "X": "full faint", "N": "hollow faint", "W": "hollow rule", "O": "full rule"}
# The numbers of each row of the table of sites and units: its loops, and what they are.
NUMBERS = "all => all.map(row => [...row.children].slice(2).map(cell => Number(cell.textContent.replace('–', '0'))))"


def until_drawn(page, cells):
    page.wait_for_function(f"(n) => {CELLS}.length === n", arg=cells)
    beside, doubled = page.evaluate(MISPLACED)
    check((beside, doubled) == (0, 0), f"the map has {cells} cells, each at a place of its own")


def rows(page, section):
    return page.locator(f"section[aria-label={section}] tbody tr")


def shown(page):
    return page.locator("section[aria-label=Loops] .summary")


def press(page, told, unit):
    """Where the map has a cell of a unit."""
    at = next(one["at"] for name, one in told.items() if name.startswith(f"{unit}: "))
    page.locator("canvas.map").click(position=at)


def whole(walk):
    page = walk.open(1440, 900)
    page.add_init_script(SCRIPT)
    page.goto(f"{walk.base}/#/fleet")
    expect(page.locator("nav [data-view=fleet]")).to_be_visible()
    until_drawn(page, ALL)
    groups = {one["group"]: one["loops"] for one in page.request.get(f"{walk.base}/api/v1/map").json()["groups"]}
    check(len(groups) == 1003 and sum(map(len, groups.values())) == ALL, "there are 10,000 loops in 1,003 units")
    told = page.evaluate(TOLD)
    expected = {f"{group}: {len(loops)} {'loop' if len(loops) == 1 else 'loops'}": len(loops) for group, loops in groups.items()}
    check({name: one["n"] for name, one in told.items()} == expected, "each unit has a cell for each of its loops, and says how many")
    letters = "".join(groups.values())
    check(page.evaluate(ALIKE) == dict(Counter(LOOKS[letter] for letter in letters)), "each loop looks as it stands")
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile(r"^10000 loops of 1003 units;"))
    expect(rows(page, "Map")).to_have_count(10)
    page.get_by_role("button", name="All 22 sites").click()
    expect(rows(page, "Map")).to_have_count(22)
    numbers = rows(page, "Map").evaluate_all(NUMBERS)
    check(all(row[0] == sum(row[1:]) for row in numbers) and sum(row[0] for row in numbers) == ALL, "the table counts each loop once")
    alarms = [row[1] for row in numbers]
    check(alarms == sorted(alarms, reverse=True) and sum(alarms) == letters.count("U"), "the sites with most alarms stand first")
    expect(shown(page)).to_have_text("50 of 10000 loops, worst first")
    walk.axe("the fleet, light")
    walk.shot("fleet")
    # By mouse from the map to a site, to a unit, to a loop.
    press(page, told, UNIT)
    expect(page.get_by_role("heading", name=f"Units of {SITE}")).to_be_visible()
    expect(page).to_have_url(re.compile(rf"#/fleet\?site={SITE}$"))
    expect(shown(page)).to_have_text("50 of 500 loops, worst first")
    until_drawn(page, 500)
    walk.shot("fleet-site")
    press(page, page.evaluate(TOLD), UNIT)
    expect(shown(page)).to_have_text("10 of 10 loops, worst first")
    check(set(rows(page, "Loops").locator("td:nth-child(3)").all_text_contents()) == {UNIT}, "they are those of the unit")
    first = rows(page, "Loops").first
    expect(first).to_contain_text("Unacknowledged alarm")
    loop = first.get_attribute("data-id")
    first.get_by_role("link").click()
    expect(page.locator("main h1")).to_have_text(loop)
    expect(page.locator(".verdict")).to_have_attribute("data-kind", "unacknowledged")
    expect(page.locator(".head p")).to_contain_text(UNIT)
    # The browser's way back goes the same steps.
    for step in ("10 of 10", "50 of 500", "50 of 10000"):
        page.go_back()
        expect(shown(page)).to_have_text(f"{step} loops, worst first")
    print("ok: by mouse from the map to a site, a unit and a loop, and back")


def by_keyboard(walk):
    page = walk.page
    for place in (SITE, UNIT):
        expect(rows(page, "Map")).to_have_count(10)
        walk.tab_to("section[aria-label=Map] > button")
        page.keyboard.press("Enter")
        walk.tab_to(f"tr[data-place='{place}'] a")
        page.keyboard.press("Enter")
    expect(shown(page)).to_have_text("10 of 10 loops, worst first")
    walk.tab_to("section[aria-label=Loops] tbody a")
    loop = page.evaluate("document.activeElement.textContent")
    page.keyboard.press("Enter")
    expect(page.locator("main h1")).to_have_text(loop)
    print("ok: by keyboard alone to a site, a unit and a loop")


def search(walk):
    page = walk.page
    page.goto(f"{walk.base}/#/fleet")
    find = page.get_by_label("Find")
    find.fill("fic-047")
    expect(shown(page)).to_have_text("50 of 100 loops, worst first")
    page.get_by_role("button", name="More", exact=True).click()
    expect(shown(page)).to_have_text("100 of 100 loops, worst first")
    found = rows(page, "Loops").evaluate_all("all => all.map(row => row.dataset.id)")
    check(sorted(name.split(":")[1] for name in found) == [f"FIC-047{n:02}" for n in range(100)], "all loops of a name are found, each once")
    find.fill("nowhere")
    expect(shown(page)).to_have_text("No loop is like this.")
    expect(rows(page, "Loops")).to_have_count(0)
    page.goto(f"{walk.base}/#/fleet?site={SITE}&q=column+17")
    expect(find).to_have_value("column 17")
    expect(shown(page)).to_have_text("10 of 10 loops, worst first")
    page.get_by_role("button", name="All sites").click()
    expect(shown(page)).to_have_text("50 of 200 loops, worst first")
    print("ok: a search goes on within a site, and beyond it")


def names(walk):
    """Names that would act if they became markup or a part of an address, a site without units, one that is not there."""
    page = walk.page
    page.goto(f"{walk.base}/#/fleet?q=%3Cimg")
    loop = rows(page, "Loops")
    expect(loop).to_have_count(1)
    expect(loop).to_contain_text(STRANGE)
    loop.get_by_role("link").click()
    expect(page.locator("main h1")).to_have_text(f"north:{NASTY}")
    page.goto(f"{walk.base}/#/fleet?site=north")
    expect(rows(page, "Map")).to_have_count(2)
    rows(page, "Map").get_by_role("link", name="2?x=1").click()
    expect(shown(page)).to_have_text("1 of 1 loop, worst first")
    page.reload()
    expect(shown(page)).to_have_text("1 of 1 loop, worst first")
    expect(rows(page, "Map")).to_have_count(2)
    page.get_by_role("button", name=f"only {STRANGE}").click()
    expect(shown(page)).to_have_text("2 of 2 loops, worst first")
    rows(page, "Map").get_by_role("link", name="no unit").click()
    expect(page.get_by_role("button", name="only north")).to_be_visible()
    expect(rows(page, "Loops")).to_have_count(1)
    expect(rows(page, "Loops")).to_have_attribute("data-id", "north:B")
    check(page.locator("main img, main b").count() == 0, "names of loops and units are text")
    page.goto(f"{walk.base}/#/fleet?site=west")
    expect(shown(page)).to_have_text("1 of 1 loop, worst first")
    expect(rows(page, "Map")).to_contain_text("no unit")
    until_drawn(page, 1)
    page.goto(f"{walk.base}/#/fleet?site=nowhere")
    expect(shown(page)).to_have_text("No loop is like this.")
    until_drawn(page, 0)
    page.get_by_role("button", name="only nowhere").click()
    expect(shown(page)).to_have_text("50 of 10000 loops, worst first")
    until_drawn(page, ALL)


def machines(walk):
    """Lag, clock, version and certificate of each machine, and what of it is told."""
    page = walk.page
    expect(page.locator("main > .summary")).to_contain_text("c1 is a centre. It is this machine's turn to tell people of alarms, where it has receivers. 20 sites, 24 machines, 1 silent.")
    expect(rows(page, "Machines")).to_have_count(24)
    heads = page.locator("section[aria-label=Machines] th").all_text_contents()
    row = {name: dict(zip(heads, page.locator(f"tr[data-machine={name}] td").all_text_contents())) for name in [f"edge-s{at:02}" for at in range(7)] + ["c2", "w1"]}
    usual = {"Site": "s06", "Machine": "edge-s06", "Role": "edge", "Version": "0.1.0", "State": "here", "Loops": "500", "Behind": "0.8 s", "Clock": "0.00 s", "Diagnoses": "4711", "Runs since": "2025-12-31 00:00:00", "Certificate until": "2027-01-01 00:00:00"}
    check(row["edge-s06"] == usual, f"a machine is told whole: {row['edge-s06']}")
    check((row["w1"]["Role"], row["w1"]["Site"], row["w1"]["Loops"], row["c2"]["Role"]) == ("worker", "–", "–", "centre"), "workers and centres stand there too")
    odd = {"edge-s00": ("Behind", "10 min"), "edge-s01": ("Clock", "+2.50 s"), "edge-s02": ("State", "silent since 2"), "edge-s03": ("Certificate until", "2026-01-11 00:00:00"), "edge-s04": ("Version", "0.0.9"), "edge-s05": ("Certificate until", "–")}
    for name, (head, text) in odd.items():
        check(row[name][head].startswith(text), f"{head} of {name}: {row[name][head]}")
    bad = page.locator("section[aria-label=Machines] .bad")
    told = bad.evaluate_all("all => all.map(one => one.closest('tr').dataset.machine)")
    check(told == ["edge-s00", "edge-s01", "edge-s02", "edge-s03"], f"what is bad is marked: {told}")
    expect(page.locator("[data-machine=edge-s03] td:last-child > span")).to_have_attribute("title", "dcs user_certificate")


def looks(walk):
    """Dark, and on a phone; then a fleet without loops."""
    page = walk.page
    page.emulate_media(color_scheme="dark")
    walk.axe("the fleet, dark")
    walk.shot("fleet-dark")
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_function("() => document.querySelector('canvas.map').width < 390")
    until_drawn(page, ALL)
    walk.fits("the fleet on a phone")
    walk.shot("fleet-phone", whole=True)
    page.get_by_role("button", name="All 22 sites").click()
    rows(page, "Map").get_by_role("link", name=SITE).click()
    until_drawn(page, 500)
    rows(page, "Map").get_by_role("link").first.click()
    expect(shown(page)).to_have_text("10 of 10 loops, worst first")
    page.goto(f"{walk.base}/#/fleet?group=north+%2F+%3Cb%3EU+%26+1%3C%2Fb%3E+%2F+2%3Fx%3D1")
    expect(shown(page)).to_have_text("1 of 1 loop, worst first")
    walk.fits("a unit with a long name on a phone")
    walk.axe("a unit, dark, on a phone")
    page.route(re.compile(r"/api/v1/map$"), lambda route: route.fulfill(json={"time": None, "total": 0, "groups": []}))
    page.route(re.compile(r"/api/v1/loops\?limit=50"), lambda route: route.fulfill(json={"time": None, "total": 0, "items": [], "next": None}))
    page.goto(f"{walk.base}/#/fleet")
    expect(shown(page)).to_have_text("There are no loops yet.")
    expect(page.locator("canvas.map")).to_have_attribute("aria-label", re.compile("^0 loops of 0 units;"))
    expect(rows(page, "Map")).to_have_count(0)
    print("ok: a fleet without loops says so")


def plant(walk):
    """The plant's page holds the worst half of the loops; it counts all of them, and each is found."""
    page = walk.open(1440, 900)
    letters = Counter("".join(one["loops"] for one in page.request.get(f"{walk.base}/api/v1/map").json()["groups"]))
    walk.go("?q=fic-00002")
    tiles, summary = page.locator(".tile"), page.locator(".summary")
    expect(tiles).to_have_count(1)
    expect(tiles).to_have_attribute("data-id", "s02:FIC-00002")
    expect(tiles).to_have_attribute("data-kind", "sound")
    expect(summary).to_have_text(f"1 of {ALL} loops")
    count = {kind: page.locator(f".counts button[data-kind={kind}]") for kind in ("unacknowledged", "unknown", "waiting", "sound")}
    for kind, letter in (("unacknowledged", "U"), ("unknown", "N"), ("waiting", "W"), ("sound", "O")):
        expect(count[kind].locator("b")).to_have_text(str(letters[letter]))
    print("ok: what is not held is counted and found")
    page.locator("#q").fill("nowhere")
    expect(summary).to_have_text("No loop is like this.")
    page.locator("#q").fill("")
    count["sound"].click()
    expect(summary).to_have_text(f"1000 of {ALL} loops, among the worst 1000 of {letters['O']}: all are on the page of the fleet")
    kinds = tiles.evaluate_all("all => [...new Set(all.map(one => one.dataset.kind))]")
    check(kinds == ["sound"], f"only loops of the kind that was pressed: {kinds}")
    page.locator("select[name=group]").select_option(UNIT)
    expect(summary).to_have_text(re.compile(rf"^\d of {ALL} loops$"))
    check(tiles.count() == sum(one["severity"] == 0 for one in page.request.get(f"{walk.base}/api/v1/loops?group=s03%20/%20U17").json()["items"]), "those of a unit")


fleet = [whole, by_keyboard, search, names, machines, looks, plant]
