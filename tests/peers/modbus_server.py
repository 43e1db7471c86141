"""A Modbus/TCP device made of pymodbus, with the faults that a test asks for.

Prints "port N" once it listens. Reads commands from stdin, one a line, and answers each with "ok":

  delay N S    the next N requests are answered S seconds late; prints "late C" for the counter C each carries
  hang A       requests that touch holding register A are never answered
  short        answers carry one register fewer than asked for
  silent U     unit U never answers
  limit N      requests of more than N registers are refused (illegal data value)
  gateway      every request is refused as by a gateway whose unit is silent
  sync         nothing: what was printed before has been read
  heal         all faults end

Holding and input registers hold every type in every byte order: order k (ABCD CDAB BADC DCBA) from
100 k, as u16, i16, u32, i32, f32, f64, u64, i64 one after the other. Coil a is set when 3 divides a, discrete input
a when 5 does. Holding registers 2000..2099 hold a truth in every four: the f64

  address 1e12 + epoch 1e9 + counter

where the epoch tells one run of this program from another and the counter counts the requests served.
2100..2101 and 2104..2105 exist, 2102..2103 do not. With --units 3 there are units 1 to 3, and the epoch of unit u > 1
is 100 u more. --framer rtu speaks RTU frames on the TCP connection.
"""

import argparse
import asyncio
import logging
import struct
import sys

from pymodbus.client.mixin import ModbusClientMixin
from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

HOLDING = [54321, -12345, 4000000123, -2000000321, -123.456, -98.7654321, 9007199254740993000, -1234567890123456]
INPUT = [1, -1, 65537, -65537, 0.0015, 3.141592653589793, 4294967297, -4294967297]
kinds = ModbusClientMixin.DATATYPE
TYPES = [kinds.UINT16, kinds.INT16, kinds.UINT32, kinds.INT32, kinds.FLOAT32, kinds.FLOAT64]
TYPES += [kinds.UINT64, kinds.INT64]
TRUTH = range(2000, 2100)


def in_every_order(values):
    blocks = []
    for order, word_order in enumerate(["big", "little", "big", "little"]):
        registers = []
        for value, datatype in zip(values, TYPES):
            registers += ModbusClientMixin.convert_to_registers(value, datatype, word_order=word_order)
        if order >= 2:
            registers = [(r & 0xFF) << 8 | r >> 8 for r in registers]
        blocks.append(SimData(address=100 * order, values=registers, datatype=DataType.REGISTERS))
    return blocks


class Device:
    def __init__(self, unit, epoch):
        self.unit = unit
        self.epoch = epoch + (100 * unit if unit > 1 else 0)
        self.counter = 0
        self.heal()

    def heal(self):
        self.delays, self.delay_s = 0, 0.0
        self.hung = None
        self.is_short = False
        self.is_gateway = False
        self.silent = None
        self.limit = None

    async def action(self, function_code, start_address, address, count, registers, set_values):
        if set_values is not None:
            say("written")
        self.counter += 1
        counter = self.counter
        if self.silent == self.unit:
            await asyncio.sleep(3600)
        if self.limit is not None and count > self.limit:
            return ExcCodes.ILLEGAL_VALUE
        if self.is_gateway:
            return ExcCodes.GATEWAY_NO_RESPONSE
        if self.hung is not None and function_code == 3 and address <= self.hung < address + count:
            await asyncio.sleep(3600)
        if self.delays > 0:
            self.delays -= 1
            say(f"late {counter}")
            await asyncio.sleep(self.delay_s)
        if function_code == 3:
            for at in TRUTH[::4]:
                truth = at * 1e12 + self.epoch * 1e9 + counter
                where = at - start_address
                registers[where : where + 4] = struct.unpack(">4H", struct.pack(">d", truth))
        return None

    def trace_pdu(self, sending, pdu):
        if sending and self.is_short and getattr(pdu, "registers", None):
            pdu.registers = pdu.registers[:-1]
        return pdu

    def command(self, words):
        match words:
            case ["delay", count, seconds]:
                self.delays, self.delay_s = int(count), float(seconds)
            case ["hang", address]:
                self.hung = int(address)
            case ["short"]:
                self.is_short = True
            case ["silent", unit]:
                self.silent = int(unit)
            case ["limit", count]:
                self.limit = int(count)
            case ["gateway"]:
                self.is_gateway = True
            case ["sync"]:
                pass
            case ["heal"]:
                self.heal()
            case _:
                sys.exit(f"unknown command {words}")


def say(line):
    print(line, flush=True)


async def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--epoch", type=int, default=1)
    parser.add_argument("--units", type=int, default=1)
    parser.add_argument("--framer", choices=["socket", "rtu"], default="socket")
    arguments = parser.parse_args()
    logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
    devices = [Device(unit, arguments.epoch) for unit in range(1, arguments.units + 1)]
    truths = SimData(address=TRUTH.start, count=len(TRUTH), datatype=DataType.REGISTERS)
    holes = [SimData(address=a, values=[a, a + 1], datatype=DataType.REGISTERS) for a in (2100, 2104)]
    bits = lambda n: [SimData(address=0, values=[a % n == 0 for a in range(64)], datatype=DataType.BITS)]
    blocks = (bits(3), bits(5), in_every_order(HOLDING) + [truths] + holes, in_every_order(INPUT))
    server = ModbusTcpServer(
        [SimDevice(id=device.unit, simdata=blocks, action=device.action) for device in devices],
        framer=FramerType(arguments.framer),
        address=("127.0.0.1", arguments.port),
        trace_pdu=devices[0].trace_pdu,
    )
    await server.serve_forever(background=True)
    say(f"port {server.transport.sockets[0].getsockname()[1]}")
    commands = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(commands), sys.stdin)
    while line := await commands.readline():
        for device in devices:
            device.command(line.decode().split())
        say("ok")


asyncio.run(main())
