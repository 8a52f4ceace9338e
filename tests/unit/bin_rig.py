"""Dataflash logs as ArduPilot writes them."""

import struct

CODES = {
    "Q": "Q",
    "B": "B",
    "f": "f",
    "c": "h",
    "L": "i",
    "Z": "64s",
    "N": "16s",
    "a": "64s",
    "n": "4s",
    "H": "H",
    "I": "I",
    "b": "b",
    "d": "d",
}


class Flash:
    """Writes records as ArduPilot does."""

    def __init__(self):
        self.data = bytearray()
        self.types = {}
        self.fmt(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)

    def fmt(self, type_, name, letters, columns, length=None):
        body = struct.Struct("<" + "".join(CODES[c] for c in letters))
        self.types[name] = type_, body
        raw = struct.pack(
            "<BB4s16s64s", type_, length or body.size + 3, name.encode(), letters.encode(), columns.encode()
        )
        self.data += b"\xa3\x95\x80" + raw

    def add(self, name, *values):
        type_, body = self.types[name]
        values = [v.encode() if isinstance(v, str) else v for v in values]
        self.data += bytes((0xA3, 0x95, type_)) + body.pack(*values)


def dive(seconds=20):
    flash = Flash()
    flash.fmt(1, "UNIT", "QbZ", "TimeUS,Id,Label")
    flash.fmt(2, "MULT", "Qbd", "TimeUS,Id,Mult")
    flash.fmt(3, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
    flash.fmt(10, "GPS", "QBIHLL", "TimeUS,Status,GMS,GWk,Lat,Lng")
    flash.fmt(11, "ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw")
    flash.fmt(12, "XKF1", "QBffff", "TimeUS,C,PN,PE,PD,VN")
    flash.fmt(13, "MSG", "QZ", "TimeUS,Message")
    flash.fmt(14, "ARR", "Qa", "TimeUS,Data")
    for letter, label in (
        ("s", "s"),
        ("m", "m"),
        ("n", "m/s"),
        ("d", "deg"),
        ("#", "instance"),
        ("D", "deglatitude"),
        ("-", ""),
    ):
        flash.add("UNIT", 100, ord(letter), label)
    for letter, factor in (("F", 1e-6), ("B", 1e-2), ("0", 1.0), ("-", 0.0), ("G", 1e-7)):
        flash.add("MULT", 100, ord(letter), factor)
    flash.add("FMTU", 100, 11, "sddd", "FBBB")
    flash.add("FMTU", 100, 12, "s#mmmn", "F-0000")
    flash.add("MSG", 1000, "ArduSub V4.5")
    flash.add("ARR", 1500, struct.pack("<32h", *range(32)))
    for k in range(seconds * 10):
        t = 2000 + k * 100_000
        flash.add("ATT", t, k, -150, 9000)
        for core in (0, 1):
            flash.add("XKF1", t + 10, core, 0.1 * k, 0.0, 2.0 + core, 1.0)
        if k % 10 == 0:
            flash.add("GPS", t + 20, 3 if k else 1, 1000 * (k // 10), 2300, 473_977_000, 85_455_940)
    return bytes(flash.data)
