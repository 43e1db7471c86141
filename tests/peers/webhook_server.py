"""A webhook that verifies by the standardwebhooks library. Prints "port N" once it listens, and for every request a line of JSON:
its status, its id, its body, and whether the library took the signature and refused forged ones.

Reads commands from stdin, one a line, and answers each with "ok":

  answer S N [A]   the next N requests are answered with status S, and Retry-After A where given
"""

import base64
import json
import os
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from standardwebhooks.webhooks import Webhook, WebhookVerificationError

secret = sys.argv[1]
plan = []


def say(text):
    # One write for text and end: print makes two, between which another thread's line can get.
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def refused(webhook, body, headers):
    try:
        webhook.verify(body, headers)
    except WebhookVerificationError:
        return True
    return False


class Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["content-length"])).decode()
        headers = {name: self.headers[name] for name in ["webhook-id", "webhook-timestamp", "webhook-signature"]}
        own = Webhook(secret)
        try:
            own.verify(body, headers)
            verified = True
        except WebhookVerificationError:
            verified = False
        other = Webhook("whsec_" + base64.b64encode(os.urandom(32)).decode())
        forged = [
            refused(own, body.replace("raised", "cleared"), headers),
            refused(own, body, headers | {"webhook-id": "msg_other"}),
            refused(own, body, headers | {"webhook-timestamp": str(int(headers["webhook-timestamp"]) - 1)}),
            refused(other, body, headers),
        ]
        status, after = plan.pop(0) if plan else (204, None)
        self.send_response(status)
        if after is not None:
            self.send_header("retry-after", after)
        self.send_header("content-length", "0")
        self.end_headers()
        say(json.dumps({"status": status, "id": headers["webhook-id"], "stamp": int(headers["webhook-timestamp"]),
                        "verified": verified, "forged_refused": all(forged), "body": json.loads(body)}))

    def log_message(self, *_):
        pass


server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
threading.Thread(target=server.serve_forever, daemon=True).start()
say(f"port {server.server_port}")
for line in sys.stdin:
    _, status, count, *after = line.split()
    plan.extend([(int(status), after[0] if after else None)] * int(count))
    say("ok")
