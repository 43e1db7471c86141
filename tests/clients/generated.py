"""Uses the client that was made from the description. Usage: generated.py FOLDER BASE"""

import sys

sys.path.insert(0, sys.argv[1])

from stictiond_client import Client
from stictiond_client.api.alarms import alarms_history, alarms_list, alarms_shelve, alarms_unshelve
from stictiond_client.api.health import health_healthz_at_root, health_metrics_at_root
from stictiond_client.api.loops import loops_detail, loops_diagnose_now, loops_diagnoses, loops_diagnosis, loops_list, loops_samples
from stictiond_client.api.system import system_collectors, system_system
from stictiond_client.models import Begun, LoopsListSort, Problem, ShelveBody

client = Client(base_url=sys.argv[2], timeout=90)

found, after = [], {}
while True:
    page = loops_list.sync(client=client, sort=LoopsListSort.ID, limit=7, **after)
    found += [item.id for item in page.items]
    if page.next_ is None:
        break
    after = {"after": page.next_}
assert len(found) == page.total == 20 and found == sorted(found), found

sticky = "PIC303"
made = loops_diagnose_now.sync(client=client, id=sticky, wait_s=60.0)
# On a machine that is too busy it is still running after a minute.
assert made.loop == sticky and (isinstance(made, Begun) or made.verdict in ("stiction", "no_stiction", "not_identifiable")), made
assert loops_detail.sync(client=client, id=sticky).id == sticky
report = loops_diagnosis.sync(client=client, id=sticky)
assert report.reason and (report.window.n > 0 or report.verdict == "not_identifiable"), report
first = loops_diagnosis.sync_detailed(client=client, id=sticky)
same = loops_diagnosis.sync_detailed(client=client, id=sticky, if_none_match=first.headers["etag"])
# The loop may have been diagnosed again in between, once; not twice at once.
again = loops_diagnosis.sync_detailed(client=client, id=sticky, if_none_match=same.headers["etag"])
assert 304 in (same.status_code, again.status_code), (same.status_code, again.status_code)
runs = loops_diagnoses.sync(client=client, id=sticky, limit=1)
assert len(runs.items) == 1
samples = loops_samples.sync(client=client, id=sticky, points=50)
assert {"op", "pv"} <= {tag.tag for tag in samples.tags}

refused = loops_detail.sync(client=client, id="NONE")
assert isinstance(refused, Problem) and refused.status == 404 and refused.type_.endswith(":unknown_loop"), refused

alarms = alarms_list.sync(client=client)
assert any(alarm.id == "PIC302/tag_bad" for alarm in alarms.items), alarms
silent = alarms_shelve.sync(client=client, id="PIC302/tag_bad", body=ShelveBody(duration_s=60.0, by="generated"))
assert silent.state.value == "shelved" and silent.by == "generated", silent
assert alarms_unshelve.sync(client=client, id="PIC302/tag_bad").state.value != "shelved"
assert alarms_history.sync(client=client, limit=2).items[0].id

assert health_healthz_at_root.sync(client=client).status == "ok"
assert "stictiond_history_memory_bytes" in health_metrics_at_root.sync(client=client)
assert system_collectors.sync(client=client).total >= 1
assert system_system.sync(client=client).loops == 20
print("the generated client works")
