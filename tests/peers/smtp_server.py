"""A mail server made of aiosmtpd, which takes mails by STARTTLS and with a password only, and nobody who greets it by an address.
Arguments: certificate, key, user and password; or "helo" alone for a server in the clear that does not know EHLO. Prints "port N"
once it listens, and a line of JSON for every mail.

Reads commands from stdin, one a line, and answers each with "ok":

  refuse N TEXT   the next N mails are refused with TEXT, which begins with a code
  moved N TO      the next N times that TO is to get a mail nobody is known by that name
  busy N TO       TO takes no mail for now, and with N = 0 does again
"""

import asyncio
import email
import email.policy
import json
import ssl
import sys

from aiosmtpd.smtp import SMTP, AuthResult, LoginPassword

old = sys.argv[1:] == ["helo"]
certificate, key, user, password = ["", "", "", ""] if old else sys.argv[1:5]
plan = []
moved = []
busy = set()


def say(text):
    print(text, flush=True)


class Handler:
    async def handle_RCPT(self, server, session, envelope, address, options):
        if address in moved:
            moved.remove(address)
            return "550 nobody by that name"
        if address in busy:
            return "450 not now"
        envelope.rcpt_tos.append(address)
        return "250 known"

    async def handle_DATA(self, server, session, envelope):
        if plan:
            return plan.pop(0)
        mail = email.message_from_bytes(envelope.original_content, policy=email.policy.default)
        say(json.dumps({
            "from": envelope.mail_from, "to": envelope.rcpt_tos, "tls": session.ssl is not None,
            "authenticated": session.authenticated, "hello": session.host_name, "extended": session.extended_smtp, "subject": mail["subject"], "id": mail["message-id"],
            "type": mail.get_content_type(), "text": mail.get_content(),
        }))
        return "250 taken"


class Strict(SMTP):
    async def smtp_EHLO(self, hostname):
        if old:
            await self.push("500 what is EHLO?")
        elif hostname.startswith("["):
            await self.push("550 an address is no name")
        else:
            await super().smtp_EHLO(hostname)


def authenticate(server, session, envelope, mechanism, data):
    good = isinstance(data, LoginPassword) and (data.login, data.password) == (user.encode(), password.encode())
    return AuthResult(success=good, handled=False)


async def main():
    loop = asyncio.get_running_loop()
    wanted = {}
    if not old:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate, key)
        wanted = dict(tls_context=context, require_starttls=True, auth_required=True, authenticator=authenticate)
    make = lambda: Strict(Handler(), hostname="localhost", loop=loop, **wanted)
    server = await loop.create_server(make, "127.0.0.1", 0)
    say(f"port {server.sockets[0].getsockname()[1]}")
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        what, count, text = line.rstrip("\n").split(" ", 2)
        if what == "busy":
            (busy.add if int(count) else busy.discard)(text)
        else:
            (plan if what == "refuse" else moved).extend([text] * int(count))
        say("ok")


asyncio.run(main())
