"""Packets as public drivers and recordings have them: typed by hand, and never made by the encoder under test."""

from deformscope_drivers.optoforce.protocol import (
    Command,
    ConfigReply,
    Configure,
    Filter,
    Kind,
    Reading,
    Reply,
    SerialReply,
    SerialRequest,
    Speed,
    Status,
    Zero,
)

FROM_DAQ: list[tuple[str, Reply]] = [
    ("aa 00 50 01 00 00 fb", ConfigReply(0)),
    (
        "aa 07 08 0a 04 d2 00 00 01 91 fe 6f 1f 53 04 0a",
        Reading(Kind.THREE_AXIS, 1234, Status(0), ((401, -401, 8019),)),
    ),
    (
        "aa 07 08 0a ff ff 00 80 00 00 00 00 4e 20 03 af",
        Reading(Kind.THREE_AXIS, 65535, Status(0x0080), ((0, 0, 20000),)),
    ),
    (  # the first of alknemeyer/optoforce's recording
        "aa 07 08 0a 2d 6a 00 00 ff f7 ff fb 00 07 05 51",
        Reading(Kind.THREE_AXIS, 0x2D6A, Status(0), ((-9, -5, 7),)),
    ),
    (  # a header within
        "aa 07 08 0a 00 00 10 01 aa 07 08 0a 7f ff 03 15",
        Reading(Kind.THREE_AXIS, 0, Status(0x1001), ((-22009, 2058, 32767),)),
    ),
    (
        "aa 07 08 1c 00 10 00 0b 00 01 ff ff 01 00 00 02 ff fe 02 00 00 03 ff fd 03 00 00 04 ff fc 04 00 08 f6",
        Reading(Kind.FOUR_CHANNEL, 16, Status(0x000B), ((1, -1, 256), (2, -2, 512), (3, -3, 768), (4, -4, 1024))),
    ),
    (
        "aa 07 08 10 80 00 02 40 03 e8 fc 18 07 d0 f8 30 01 2c fe d4 07 88",
        Reading(Kind.SIX_AXIS, 32768, Status(0x0240), ((1000, -1000, 2000, -2000, 300, -300),)),
    ),
    ("aa 00 12 08 49 53 45 30 41 31 32 39 02 b2", SerialReply("ISE0A129")),
]

TO_DAQ: list[tuple[str, Command]] = [
    ("aa 00 32 03 0a 04 00 00 ed", Configure(Speed.HZ_100, Filter.HZ_15, Zero.CLEAR)),
    ("aa 00 32 03 01 02 ff 01 e1", Configure(Speed.HZ_1000, Filter.HZ_150, Zero.SET)),
    ("aa 00 32 03 01 00 00 00 e0", Configure(Speed.HZ_1000, Filter.NONE, Zero.CLEAR)),
    ("aa 00 32 03 00 04 00 00 e3", Configure(Speed.STOP, Filter.HZ_15, Zero.CLEAR)),
    ("ab 00 12 08 00 c5", SerialRequest()),
]
