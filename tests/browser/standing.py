"""How loops stand among others: score and cost in the list of loops, and a plant that is sorted by them."""

from playwright.sync_api import expect

from walk import check


def standing(walk):
    page = walk.open(1440, 900)
    walk.go("fleet")
    table = page.locator("section[aria-label=Loops]")
    expect(table.locator("tbody tr")).to_have_count(20)
    heads = table.locator("th").all_text_contents()

    def told(loop):
        row = dict(zip(heads, table.locator(f"tr[data-id={loop}] td").all_text_contents()))
        return row["Score"], row["Cost"]

    check([told(f"FIC000{n:02}") for n in (8, 19, 7)] == [("40", "80 EUR/day"), ("95", "–"), ("–", "–")], "the list has score and cost of each loop")
    walk.axe("the list with score and cost")
    page.set_viewport_size({"width": 390, "height": 844})
    cells = table.locator("tr[data-id=FIC00008] td")
    for name in ("Score", "Cost"):
        expect(table.locator("th").nth(heads.index(name))).to_be_hidden()
        expect(cells.nth(heads.index(name))).to_be_hidden()
    expect(cells.nth(heads.index("State"))).to_be_visible()
    walk.fits("the list of loops on a phone")
    page.set_viewport_size({"width": 1440, "height": 900})
    walk.go()
    expect(page.locator(".tile")).to_have_count(20)
    sort = page.locator("select[name=sort]")

    def names():
        return page.locator(".tile").evaluate_all("all => all.map((one) => one.dataset.id)")

    sort.select_option("score")
    check(names()[:3] == ["FIC00000", "FIC00001", "FIC00002"] and names()[-1] == "FIC00007", f"the worst score stands first, an unknown one last: {names()}")
    sort.select_option("cost")
    check(names()[:4] == ["FIC00016", "FIC00012", "FIC00008", "FIC00004"], f"the greatest cost stands first: {names()}")
    title = page.locator(".tile[data-id=FIC00008]").get_attribute("title")
    check("score 40 of 100" in title and "its swing costs 80 EUR/day" in title, "a tile tells both")

    walk.go("loop/FIC00008")
    card = page.locator(".card", has=page.locator("h2", has_text="Health"))
    expect(card).to_contain_text("0.75 (0.5 … 0.88) for a dead time of 20 s by the loop's model, and one sample")
    expect(card).to_contain_text("60 s (50 % of its variance, regularity 2.5); 10 min (50 % of its variance, regularity 2.5)")
    expect(card).to_contain_text("3 of 4 settled in 42 s, overshoot 13 %")
    check(card.locator("rect").count() == 20 and "half of it below 50" in card.text_content(), "OP's distribution is drawn and told")
    check(card.locator("tbody tr").count() == 22 and "Compression of PV" in card.text_content(), "every indicator has a row")
    walk.axe("what a look found of a loop")
