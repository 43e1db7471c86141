# Pulls f of every loop into pandas. Run it as a script, or cell by cell in an editor that knows "# %%".
# Usage: python examples/pandas_f.py [BASE [TOKEN]]     needs pandas and nothing else

# %% Where the daemon is
import json
import sys
from urllib.parse import quote, urlencode
from urllib.request import Request, urlopen

import pandas as pd

BASE = sys.argv[1] if len(sys.argv) > 1 and sys.argv[1].startswith("http") else "http://127.0.0.1:8080"
TOKEN = sys.argv[2] if len(sys.argv) > 2 else None  # of `stictiond token create`, where there is a log-in


def get(path, **query):
    """One answer of the API."""
    request = Request(f"{BASE}/api/v1{path}?{urlencode(query)}")
    if TOKEN:
        request.add_header("Authorization", f"Bearer {TOKEN}")
    with urlopen(request, timeout=30) as answer:
        return json.load(answer)


def pages(path, **query):
    """All entries of a list, page by page."""
    after = {}
    while True:
        page = get(path, **query, **after)
        yield from page["items"]
        if page["next"] is None:
            return
        after = {"after": page["next"]}


# %% f of every loop now, with its 95 % interval, worst first
loops = pd.DataFrame(pages("/loops", limit=500)).set_index("id")
interval = loops["f_ci95"].apply(lambda pair: pd.Series(pair or [None, None], index=["f_low", "f_high"]))
f = loops[["group", "verdict", "f", "f_unit", "delta_aic", "alarm"]].join(interval.astype(float))
f[["f", "delta_aic"]] = f[["f", "delta_aic"]].astype(float)  # null where nothing can be told
f["time"] = pd.to_datetime(loops["time"], format="ISO8601")
print(f.sort_values("f", ascending=False).to_string(float_format="%.2f"))

# %% f over time: one column a loop, one row a diagnosis
history = pd.concat(
    [pd.DataFrame(pages(f"/loops/{quote(id, safe='')}/diagnoses", limit=1000)).assign(loop=id) for id in loops.index],
    ignore_index=True,
)
if history.empty:
    sys.exit("nothing has been diagnosed yet")
history["time"] = pd.to_datetime(history["time"], format="ISO8601")
history["f"] = history["f"].astype(float)
over_time = history.dropna(subset=["f"]).pivot_table(index="time", columns="loop", values="f")
if over_time.empty:
    print("no diagnosis has found f yet")
else:
    print(over_time.describe().T[["count", "mean", "min", "max"]].to_string(float_format="%.2f"))

# %% PV and OP of the worst loop as one frame, what is not good left out
worst = f["f"].idxmax() if f["f"].notna().any() else f.index[0]
samples = get(f"/loops/{quote(worst, safe='')}/samples", points=2000)
columns = {}
for tag in samples["tags"]:
    column = pd.Series(tag["value"], index=pd.to_datetime(tag["time"], format="ISO8601"), dtype=float)
    columns[tag["tag"]] = column[[quality == "good" for quality in tag["quality"]]].groupby(level=0).last()
trend = pd.DataFrame(columns)
print(worst)
print(trend.tail().to_string(float_format="%.2f"))
# trend[["pv", "op"]].plot(subplots=True)   # with matplotlib
