"""An OPC UA server made of asyncua, with the faults that a test asks for.

Prints "port N" once it listens. Reads commands from stdin, one a line, and answers each with "ok":

  silent         data changes are sampled no more, while the session stays alive
  set NODE V     writes a value with the time of now
  bad NODE       writes the status BadSensorFailure
  uncertain NODE writes the status UncertainLastUsableValue
  max            prints "max N", the most nodes that one read asked for
  jump S         sets the clock of Counter by S seconds, its count too
  drop           ends every connection, while the server goes on
  count N        answers once Counter has counted N further

Nodes of namespace 2, all Doubles, are steady: Steady0..Steady29 hold 0.0..29.0. Counter (numeric id 1000, below
Plant/Unit, a browse path) counts up every 20 ms; the value is the number of 20 ms since the Unix epoch, so that a
sample can be checked against its own source time, also across restarts. With --history its values are kept, and with
--backlog S those of the last S seconds too, as by a historian that went on while no server ran. One answer gives as
many as were asked for and no continuation point, or with --cap N at most N and a continuation point. Flag is a Boolean,
Array holds 10.0, 11.0 and 12.0, Text "12,5", Doubtful "1,002" and When a time. FIC101 has an OP of 41.5 and a PV of 50.5.
With --other first or last there is a second plant of the namespace urn:peer:other, numbered before or after the first,
with the same names: its Steady0..Steady29 hold 100.0..129.0.
--secure DIR makes certificates of server, client and user there, and takes no session without security and a user name
or certificate. With --expired the server's has been out of date since yesterday.
"""

import argparse
import asyncio
import datetime
import socket
import sys
from pathlib import Path

from asyncua import Server, ua
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.ua.uaerrors import BadTooManyOperations
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

TICK_S = 0.02
EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)


def at(tick):
    return EPOCH + datetime.timedelta(milliseconds=20 * tick)


def say(text):
    print(text, flush=True)


class Users(UserManager):
    """Knows one user by name and one by certificate."""

    def __init__(self, known):
        self.known = known

    def get_user(self, iserver, username=None, password=None, certificate=None):
        if username == "operator" and password == "right":
            return User(role=UserRole.User)
        # Where a user name is given, the certificate is that of the application.
        if username is None and self.der(certificate) == self.known:
            return User(role=UserRole.User)
        return None

    @staticmethod
    def der(certificate):
        if isinstance(certificate, x509.Certificate):
            return certificate.public_bytes(serialization.Encoding.DER)
        return certificate


def limit_reads(most):
    """Refuses what a server with this limit refuses, and remembers what was asked."""
    asked = {"max": 0}
    plain = InternalSession.read

    async def read(self, params):
        if self.external:
            asked["max"] = max(asked["max"], len(params.NodesToRead))
            if most and len(params.NodesToRead) > most:
                raise BadTooManyOperations()
        return await plain(self, params)

    InternalSession.read = read
    return asked


def certificate(folder, name, days=365):
    """A self-signed certificate, valid until so many days from now, and its key."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    uri = "urn:peer" if name == "server" else "urn:stictiond"
    own = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.timezone.utc)
    built = (
        x509.CertificateBuilder(own, own, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=400))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(
            x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri), x509.DNSName("localhost")]), False
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), False)
        .add_extension(x509.KeyUsage(True, True, True, True, False, False, False, False, False), False)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), False
        )
        .sign(key, hashes.SHA256())
    )
    pem, der = Path(folder) / f"{name}.pem", Path(folder) / f"{name}.der"
    der.write_bytes(built.public_bytes(serialization.Encoding.DER))
    pem.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    return der, pem


class Peer:
    def __init__(self, args):
        self.args = args
        self.asked = limit_reads(args.max_read)
        self.is_silent = False
        self.jump_s = 0.0
        self.tick = round(datetime.datetime.now(datetime.timezone.utc).timestamp() / TICK_S)
        self.counted = 0

    async def start(self):
        args = self.args
        if args.secure:
            cert, key = certificate(args.secure, "server", days=-1 if args.expired else 365)
            certificate(args.secure, "client")
            user, _ = certificate(args.secure, "user")
            certificate(args.secure, "stranger")
            self.server = server = Server(user_manager=Users(user.read_bytes()))
        else:
            self.server = server = Server()
        await server.init()
        port = args.port
        if port == 0:
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
        server.set_endpoint(f"opc.tcp://localhost:{port}/peer/")
        if args.secure:
            await server.set_application_uri("urn:peer")
            await server.load_certificate(str(cert))
            await server.load_private_key(str(key))
            server.set_security_policy(
                [
                    ua.SecurityPolicyType.Basic256Sha256_Sign,
                    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
                    ua.SecurityPolicyType.Aes256Sha256RsaPss_Sign,
                    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
                ]
            )
            server.set_identity_tokens([ua.UserNameIdentityToken, ua.X509IdentityToken])
        else:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        if args.max_read:
            limit = server.get_node(ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead)
            # With --unsaid the limit is enforced, but not told.
            await limit.write_value(ua.Variant(0 if args.unsaid else args.max_read, ua.VariantType.UInt32))
        # 0 is the standard's and 1 the server's own.
        if args.other == "first":
            await self.plant("urn:peer:other", 100)
        ns, unit, self.nodes = await self.plant("urn:peer:plant", 0)
        if args.other == "last":
            await self.plant("urn:peer:other", 100)
        for name, value in [
            ("Flag", True),
            ("Array", [10.0, 11.0, 12.0]),
            ("Text", "12,5"),
            ("Doubtful", "1,002"),
            ("When", EPOCH),
        ]:
            self.nodes[name] = await unit.add_variable(ua.NodeId(name, ns), f"{ns}:{name}", value)
        loop = await unit.add_object(ua.NodeId("FIC101", ns), f"{ns}:FIC101")
        for name, value in [("OP", 41.5), ("PV", 50.5)]:
            await loop.add_variable(ua.NodeId(f"FIC101.{name}", ns), f"{ns}:{name}", value)
        self.counter = await unit.add_variable(ua.NodeId(1000, ns), f"{ns}:Counter", 0.0)
        self.nodes["Counter"] = self.counter
        if args.history:
            # Before anybody can ask.
            self.store = server.iserver.history_manager.storage
            if args.cap:
                self.store.max_history_data_response_size = args.cap
            await self.store.new_historized_node(self.counter.nodeid, None, 100_000)
            for tick in range(self.tick - round(args.backlog / TICK_S), self.tick):
                await self.store.save_node_value(self.counter.nodeid, self.value(tick))
        # Who connects before the first tick must not find the 0.0 of a variable that was never written.
        await self.write(self.tick)
        await server.start()
        say(f"port {port}")

    async def plant(self, uri, offset):
        """A plant with its steady nodes in a namespace of its own."""
        ns = await self.server.register_namespace(uri)
        plant = await self.server.nodes.objects.add_object(ua.NodeId("Plant", ns), f"{ns}:Plant")
        unit = await plant.add_object(ua.NodeId("Unit", ns), f"{ns}:Unit")
        nodes = {}
        for k in range(30):
            name = f"Steady{k}"
            nodes[name] = await unit.add_variable(ua.NodeId(name, ns), f"{ns}:{name}", float(offset + k))
        return ns, unit, nodes

    def value(self, tick):
        value = ua.Variant(float(tick), ua.VariantType.Double)
        return ua.DataValue(value, SourceTimestamp=at(tick), ServerTimestamp=at(tick))

    async def write(self, tick):
        if self.args.history:
            await self.store.save_node_value(self.counter.nodeid, self.value(tick))
        await self.counter.write_value(self.value(tick))

    async def count(self):
        jumped, tick = self.jump_s, self.tick
        while True:
            now = (datetime.datetime.now(datetime.timezone.utc).timestamp() + self.jump_s) / TICK_S
            if jumped != self.jump_s:
                tick, jumped = tick + round((self.jump_s - jumped) / TICK_S), self.jump_s
            while tick < now:
                tick += 1
                if self.is_silent:
                    # As a server whose sampling has died: the value is there, nobody is told.
                    self.server.iserver.aspace._nodes[self.counter.nodeid].attributes[
                        ua.AttributeIds.Value
                    ].value = self.value(tick)
                else:
                    await self.write(tick)
                self.counted += 1
            await asyncio.sleep(TICK_S / 2)

    async def command(self, words):
        now = datetime.datetime.now(datetime.timezone.utc)
        match words:
            case ["silent"]:
                self.is_silent = True
            case ["set", node, value]:
                value = ua.Variant(float(value), ua.VariantType.Double)
                await self.nodes[node].write_value(ua.DataValue(value, SourceTimestamp=now, ServerTimestamp=now))
            case ["bad", node]:
                status = ua.StatusCode(ua.StatusCodes.BadSensorFailure)
                await self.nodes[node].write_value(ua.DataValue(None, status, SourceTimestamp=now))
            case ["uncertain", node]:
                status = ua.StatusCode(ua.StatusCodes.UncertainLastUsableValue)
                value = ua.Variant(1.0, ua.VariantType.Double)
                await self.nodes[node].write_value(ua.DataValue(value, status, SourceTimestamp=now))
            case ["jump", seconds]:
                self.jump_s += float(seconds)
            case ["drop"]:
                for session in list(self.server.bserver.clients):
                    session.transport.abort()
            case ["count", ticks]:
                end = self.counted + int(ticks)
                while self.counted < end:
                    await asyncio.sleep(TICK_S)
            case ["max"]:
                say(f"max {self.asked['max']}")
            case _:
                sys.exit(f"unknown command {words}")


async def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--secure", default="")
    parser.add_argument("--expired", action="store_true")
    parser.add_argument("--cap", type=int, default=0)
    parser.add_argument("--history", action="store_true")
    parser.add_argument("--backlog", type=float, default=0.0)
    parser.add_argument("--max-read", type=int, default=0)
    parser.add_argument("--unsaid", action="store_true")
    parser.add_argument("--other", choices=["first", "last"])
    peer = Peer(parser.parse_args())
    await peer.start()
    counting = asyncio.create_task(peer.count())
    loop = asyncio.get_running_loop()
    while True:
        line = await loop.run_in_executor(None, sys.stdin.readline)
        if not line:
            break
        if counting.done():
            counting.result()
        await peer.command(line.split())
        say("ok")


asyncio.run(main())
