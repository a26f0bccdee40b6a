"""Events by chance, and recordings of them written by the rules of their formats."""

from struct import pack

import numpy as np

from vprbench.api import Events


def by_chance(n, seed=0, seconds=3.0, height=20, width=30):
    """Return n events in the order of their times, which begin at 5 s."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(5_000_000, 5_000_000 + round(seconds * 1e6), n))
    x, y = (rng.integers(0, most, n).astype(np.uint16) for most in (width, height))
    return Events(t, x, y, rng.random(n) < 0.5)


def columns(events):
    return events.t, events.x, events.y, events.p


def in_chunks(events, seed=0):
    """Yield the events in pieces of any length, empty ones too."""
    cuts = np.sort(np.random.default_rng(seed).integers(0, len(events.t), 7))
    pieces = (np.split(column, cuts) for column in columns(events))
    yield from (Events(*piece) for piece in zip(*pieces, strict=True))


def joined(chunks):
    return Events(*(np.concatenate(column) for column in zip(*map(columns, chunks), strict=True)))


def same(first, second):
    pairs = zip(columns(first), columns(second), strict=True)
    return all(one.dtype == other.dtype and np.array_equal(one, other) for one, other in pairs)


def write_aedat2(file, events, begin=0):
    """Write AEDAT 2.0 as a DAVIS does, its clock `begin` microseconds ahead; an image sample and a signal beside."""
    words = []
    for t, x, y, p in zip(*(c.tolist() for c in columns(events)), strict=True):
        words += [y << 22 | x << 12 | int(p) << 11, (t + begin) % 2**32]
    beside = [1 << 31 | 3 << 12, words[1], 1 << 10, words[1]]
    head = b"#!AER-DAT2.0\r\n# a DAVIS346\r\n"
    file.write_bytes(head + np.array([*words[:2], *beside, *words[2:]], ">u4").tobytes())
    return file


def write_evt3(file, events):
    """Write EVT 3.0 with one word for each coordinate that changes; the clock of 24 bits begins with the events."""
    words, row = [], None
    last = (-1, -1)
    for t, x, y, p in zip(*(c.tolist() for c in columns(events)), strict=True):
        high, low = t >> 12 & 0xFFF, t & 0xFFF
        words += [0x8000 | high] * (high != last[0]) + [0x6000 | low] * ((high, low) != last) + [y] * (y != row)
        words.append(0x2000 | int(p) << 11 | x)
        last, row = (high, low), y
    head = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% end\n"
    file.write_bytes(head + np.array(words, "<u2").tobytes())
    return file


def write_aedat4(file, events, per_packet=100):
    """Write AEDAT 4.0 with one stream of events, each packet a flatbuffer of its own, nothing compressed."""

    def sized(content):
        return pack("<I", len(content)) + content

    info = b'<dv version="2.0"><node name="outInfo"><node name="0"><attr key="typeIdentifier" type="string">EVTS</attr>'
    info += b'<node name="info"><attr key="sizeX" type="int">30</attr><attr key="sizeY" type="int">20</attr></node>'
    info += b"</node></node></dv>"
    # Root, identifier, table of fields (only the third is there), the table itself, and the text that it points to.
    head = pack("<I4s5HxxiI", 20, b"IOHE", 10, 8, 0, 0, 4, 12, 4) + sized(info) + b"\0"
    rows = np.zeros(len(events.t), np.dtype("<i8,<i2,<i2,?,V3"))
    rows["f0"], rows["f1"], rows["f2"], rows["f3"] = events.t, events.x, events.y, events.p
    packets = b""
    for at in range(0, len(rows), per_packet):
        chosen = rows[at : at + per_packet]
        packet = sized(pack("<I4s3HxxiII", 16, b"EVTS", 6, 8, 4, 8, 4, len(chosen)) + chosen.tobytes())
        packets += pack("<II", 0, len(packet)) + packet
    file.write_bytes(b"#!AER-DAT4.0\r\n" + sized(head) + packets)
    return file
