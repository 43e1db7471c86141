"""An edge node of Sparkplug B made of pysparkplug's messages and paho, and a reader of such messages.

    sparkplug_edge.py PORT edge     commands on stdin, one a line, each answered with "ok":
        connect N            connects with session N and leaves an NDEATH as a will
        births X             NBIRTH, and DBIRTH of device d: op = X (alias 3), level = -7 (alias 4, Int32)
        data X               DDATA, op = X by alias only, no data type
        skip                 one number of the sequence is left out
        gone                 DDEATH of the device
        cut                  the connection is dropped, so that the broker speaks the will
    Prints "rebirth" when births are asked for.

    sparkplug_edge.py PORT read     prints "TOPIC {metrics}" for each message of others; "rebirth G/E" asks for births
"""

import json
import sys
import threading
import time

import paho.mqtt.client as paho
import pysparkplug as spb
from pysparkplug import DataType, Metric

port, kind = int(sys.argv[1]), sys.argv[2]


def say(line):
    # One write for text and end: print makes two, between which another thread's line can get.
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def now():
    return int(time.time() * 1000)


def metric(name, datatype, value, alias=None):
    return Metric(timestamp=now(), name=name, datatype=datatype, value=value, alias=alias)


class Edge:
    seq = 0

    def number(self):
        number, self.seq = self.seq, (self.seq + 1) % 256
        return number

    def publish(self, topic, payload):
        self.client.publish(f"spBv1.0/g/{topic}", payload.encode(), qos=1).wait_for_publish(10)

    def heard(self, client, userdata, message):
        command = spb.NCmd.decode(message.payload)
        if any(m.name == "Node Control/Rebirth" and m.value for m in command.metrics):
            say("rebirth")

    def connect(self, session):
        self.bdseq = metric("bdSeq", DataType.INT64, session)
        self.client = paho.Client("edge-of-test")
        will = spb.NDeath(timestamp=now(), bd_seq_metric=self.bdseq)
        self.client.will_set("spBv1.0/g/NDEATH/e", will.encode(), qos=1)
        self.client.on_message = self.heard
        self.client.connect("127.0.0.1", port, keepalive=30)
        self.client.loop_start()
        self.client.subscribe("spBv1.0/g/NCMD/e", qos=1)

    def births(self, value):
        self.seq = 0
        control = metric("Node Control/Rebirth", DataType.BOOLEAN, False)
        birth = spb.NBirth(timestamp=now(), seq=self.number(), metrics=(self.bdseq, control))
        self.publish("NBIRTH/e", birth)
        metrics = (metric("op", DataType.DOUBLE, value, 3), metric("level", DataType.INT32, -7, 4))
        self.publish("DBIRTH/e/d", spb.DBirth(timestamp=now(), seq=self.number(), metrics=metrics))

    def command(self, words):
        # Measurements of one tag lie apart: two within a millisecond would have the same time.
        time.sleep(0.01)
        match words:
            case ["connect", session]:
                self.connect(int(session))
            case ["births", value]:
                self.births(float(value))
            case ["data", value]:
                metrics = (metric(None, DataType.DOUBLE, float(value), 3),)
                self.publish("DDATA/e/d", spb.DData(timestamp=now(), seq=self.number(), metrics=metrics))
            case ["skip"]:
                self.number()
            case ["gone"]:
                self.publish("DDEATH/e/d", spb.DDeath(timestamp=now(), seq=self.number()))
            case ["cut"]:
                self.client._sock_close()
                self.client.loop_stop()
            case _:
                sys.exit(f"unknown command {words}")


class Reader:
    births = {}

    def __init__(self):
        self.client = paho.Client("reader-of-test")
        self.client.on_message = self.heard
        subscribed = threading.Event()
        self.client.on_subscribe = lambda *_: subscribed.set()
        self.client.connect("127.0.0.1", port, keepalive=30)
        self.client.loop_start()
        self.client.subscribe("spBv1.0/#", qos=1)
        subscribed.wait(10)

    def heard(self, client, userdata, message):
        kind = message.topic.split("/")[2]
        readers = {"NBIRTH": spb.NBirth, "DBIRTH": spb.DBirth, "DDATA": spb.DData}
        if kind == "NDEATH":
            death = spb.NDeath.decode(message.payload)
            say(f"{message.topic} {json.dumps({'bdSeq': death.bd_seq_metric.value})}")
        elif kind in readers:
            payload = readers[kind].decode(message.payload)
            values = {m.name: m.value for m in payload.metrics} | {"seq": payload.seq}
            say(f"{message.topic} {json.dumps(values)}")

    def command(self, words):
        match words:
            case ["rebirth", node]:
                group, edge = node.split("/")
                control = metric("Node Control/Rebirth", DataType.BOOLEAN, True)
                command = spb.NCmd(timestamp=now(), metrics=(control,))
                raw = command.encode(include_dtypes=True)
                self.client.publish(f"spBv1.0/{group}/NCMD/{edge}", raw, qos=1).wait_for_publish(10)
            case _:
                sys.exit(f"unknown command {words}")


program = Edge() if kind == "edge" else Reader()
say("ready")
for line in sys.stdin:
    program.command(line.split())
    say("ok")
