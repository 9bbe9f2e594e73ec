"""Settings with one fault each: « marks the place of the fault, and is not in the file."""

from .whole_config import BASE

_ROLL = '{ use = "roll", address = 0, type = "s32", scale = 0.001 }'
_SENSOR = f"""sensor = {{ name = "X", limit_deg = 0.01, from_c = -20, to_c = 60, limit_elsewhere_deg = 0.05, \
deg_per_k = 0.0005, range_deg = 30, roll_is = "inclination", registers = [{_ROLL}, \
{{ use = "temperature", address = 4, scale = 0.01 }}, \
{{ use = "identity", address = 9, must_be = 3 }}] }}"""


def _sensor(old: str, new: str) -> str:
    """A data sheet with one fault."""
    return _SENSOR.replace(old, new) if old != "«" else _SENSOR.replace(_ROLL, f"{_ROLL}, {_ROLL}")


TABLE = r"""
[unit]
serial = «4711                       # 4711 is not text
serial = «""                         # "" is too short; possible: text, 1 to 64
serial = «"A\u001b[2J\u202e\nB"      # A\x1b[2J\u202e\nB has a character that is not printable
calibration = «3                     # 3 is not a path
instrument = «"row"                  # possible:
kind = «"Desk"                       # possible: "machine" or "desk"; did you mean `desk`?
«colour = 3                          # no such key; possible: calibration, instrument, kind, serial
«serail = "TEST-1"; -serial          # no such key; possible: calibration, instrument, kind, serial; did you
[targets.0]
name = «"Front"                      # has characters that are not allowed
z_mm = «nan                          # nan is not a finite number
glass_mm = «-4.0                     # -4.0 is too small; possible:
glass_index = «0.9                   # 0.9 is too small; possible:
glass_index = «1.5                   # there is no glass_mm;
[targets.1]
name = «"front"                      # "front" is already the name of targets.0; choose another
z_mm = «"far"                        # "far" is not a number; possible: number from -100000 to 100000
z_mm = «0.0                          # 0 must exceed z_mm of targets.0, 0
z_mm = «-280.0                       # -280 must exceed z_mm of targets.0, 0
camera = «"raer"                     # no table [cameras.raer];
camera = «"front"                    # "front" is already the camera of targets.0; choose another
camera = «"third"                    # there is no table [cameras.third]; possible: "front", "rear"
-z_mm                                # this key is missing; possible: number
[cameras.front]
driver = «"v4l"                      # did you mean `v4l2`?
driver = «"magic"                    # "magic" is not possible; possible: "recording" or "v4l2"
device = «"video0"                   # is not the path of a device
width = «32                          # 32 is too small; possible: whole number from 64 to 16384
width = «752.5                       # 752.5 is not a whole number
fps = «0                             # 0 is too small; possible: number from 1 to 1000
pixel_format = «"Mono8"              # "GREY" or "Y10" or
controls = { gain = «"much" }        # .gain: "much" is not a whole number
controls = «16                       # 16 is not a table
«trigger = "free"                    # it is a key of [cameras.NAME] with driver = "aravis"
row_time_us = «nan                   # nan is not a finite number
row_time_us = «-105                  # makes 480 rows last longer than a frame; possible: up to 104.4
pixel_format = «"yuyv"               # did you mean `YUYV`?
«interface = "usb"                   # it is a key of [cameras.NAME] with driver = "aravis"
-device                              # this key is missing; possible: path
[cameras.rear]
interface = «"eth0"                  # possible: "gige" or "usb"
packet_bytes = «8228; interface = "usb" # is for interface = "gige" alone
pixel_format = «"YUYV"               # "Mono8" or "Mono10" or
fps = «10                            # 10 is not the rate of camera "front"; possible: 20
features = { Gamma = «[1.0] }        # .Gamma: a list cannot be used; possible: number,
device = «"300.1.1.1"                # "300.1.1.1" is not an IP address
device = «"224.0.0.1"                # is an address that no camera has
trigger = «"cable"                   # possible: "free" or "software" or "line"
packet_bytes = «20000                # 20000 is too large
max_celsius = «-6.0                  # possible: above -5
[cameras.rear.exposure]
control = «"automatic"               # is not possible; possible:
exposure_ms = «30.0                  # from shortest_ms 0.05 to
gain_db = «24.0                      # possible: up to largest_gain_db 12
exposure_ms = «60.0; control = "fixed" # 60 is longer than from frame to frame; possible: up to 50
[measuring]
window = «0                          # 0 is too small; possible: whole number from 1 to 1000
every = «2000                        # 2000 is too large
pair_by = «"sequence"                # "sequence" is for recordings; possible: "time"
max_skew_ms = «-1                    # -1 is too small; possible: number above 0
silent_after_s = «0.05               # possible: above 0.05
output = «"newest"                   # "newest" is not possible; possible: "mean" or "now"
window = «7; output = "now"          # 7 exposures are too few for output = "now"; possible: from 8
«windw = 20; -window                 # did you mean `window`?
stale_after_s; every = 20            # 1 is shorter than a value interval; possible: above 1
[installation]
sign_x = «0                          # 0 is not possible; possible: -1 or 1
offset_x_mm = «1e6                   # 1000000.0 is too large
offset_yaw_deg = «90                 # 90 is too large
offset_yaw_deg = «90.0               # 90.0 is too large; possible: number from -45 to 45
offset_y_mm = «1e200                 # 1e+200 is too large; possible: number from -100000 to 100000
expansion = «{ distance_ppm_per_k = 23.6 }; -thermometer # is corrected by a thermometer; add
thermometer = «"hosing"              # "hosing" is not the name of a thermometer; did you mean `housing`?
expansion = { distance_ppm_per_k = «230.0 } # .distance_ppm_per_k: 230.0 is too large
expansion = { view_sigma_ppm_per_k = «0.0 } # .view_sigma_ppm_per_k: 0.0 is too small
[machine]
roll_deg = «2.0; roll_sigma_deg = 0.1 # is already measured by the inclinometer; possible: without
roll_sigma_deg = «-1.0               # -1.0 is too small
roll_deg = «2.0; mount_sigma_deg = 0.1 # its uncertainty is not stated; add roll_sigma_deg
mount_yaw_deg = «46.0                # 46.0 is too large; possible: number from -45 to 45
[machine.points.0]
name = «"Cutter head"                # has characters that are not allowed
x_mm = «"left"                       # "left" is not a number
-sigma_mm                            # this key is missing; possible: number
[machine.points.1]
name = «"cutterhead"                 # is already the name of a point; choose another
sigma_mm = «-1.0                     # -1.0 is too small; possible: number from 0 to 1000
[modbus_tcp]
host = «"224.0.0.1"                  # address of groups
host = «"fe80::1"                    # name its interface
reserved = [«"192.168.1.10:502", "192.168.1.10"] # .0: is not a network
roles = [«""]                        # .0: is too short
unit_id = «248                       # 248 is too large; possible: whole number from 1 to 247
allow_self_check = «1.5              # neither true nor false
certificate; -client_ca              # is set without client_ca; possible: both
certificate; -key                    # is set without key; possible: both
allow_zero; -roles                   # is set without roles; possible: both: over TLS a client needs a role
[http]
host = «"240.0.0.1"                  # an address that no computer has
host = «"::ffff:10.0.0.1"            # write 10.0.0.1
allow = [«"10.0.0.1/8", "fd00::/8"]  # .0: possible: 10.0.0.0/8
allow = [«"plant", "fd00::/8"]       # .0: is not a network
allow = [«"::ffff:10.0.0.0/104", "fd00::/8"] # .0: write it as IPv4
names = [«"http://alt-0007.plant.example"] # .0: is not a host name
allow = «"10.0.0.0/8"                # ; did you mean `["10.0.0.0/8"]`?
port = «502                          # port 502 is already used by [modbus_tcp]; choose another
port = «70000                        # 70000 is too large; possible: whole number from 0 to 65535
«allow_self_check = true             # it is a key of [modbus_tcp]
key = «"unit.key"; -certificate      # is set without certificate
certificate = «"unit.pem"; -key      # is set without key
[mqtt]
host = «"mqtt://broker.plant.example" # is not a host name
host = «"broker.plant:1883"          # alt-0007.plant, without scheme and port
port = «0                            # 0 is too small; possible: whole number from 1 to 65535
topic = «"plant/#"                   # is not a topic prefix; possible: letters
topic = «"/plant"                    # is not a topic prefix
topic = «"$SYS"                      # is not a topic prefix
topic = «"plant/+/altd"              # is not a topic prefix
home_assistant = «"homeassistant"; sparkplug = {group = "line-4"} # does not go with [mqtt.sparkplug]
«password = "b"                      # `credentials` is its path
«hsot = "broker.plant.example"; -host # no such key;
«sparkplug = {}; -home_assistant     # .group: is missing
sparkplug = {group = «"plant/4"}; -home_assistant # .group: is not an identifier; possible: letters, digits
sparkplug = {group = «"#"}; -home_assistant # .group: is not an identifier; possible: letters, digits
sparkplug = {group = «"a\u0007"}; -home_assistant # .group: is not an identifier; possible: letters, digits
sparkplug = {group = "4", node = «"+"}; -home_assistant # .node: is not an identifier
certificate; -ca                     # is set without ca; possible: both
certificate; -key                    # is set without key; possible: both
[opcua]
port = «502                          # port 502 is already used by [modbus_tcp]; choose another
port = «8080                         # port 8080 is already used by [http]; choose another
certificate; -key                    # is set without key; possible: both
credentials; -certificate; -key      # is set without certificate; possible: both
[local]
socket = «"altd.sock"                # "altd.sock" is not an absolute path
socket = «"/run/\u0007x"             # is not an absolute path
[serial.0]
speaks = «"telegramm"                # did you mean `telegram`?
baud = «9601                         # 9601 is not possible; possible: 1200 or 2400
interval_s = «0.1                    # 0.1 is too short at 9600 baud; possible: from 0.18
interval_s = «0.2; checked = true    # 0.2 is too short at 9600 baud; possible: from 0.26
interval_s = «0.3; checked = true; identify_every_s = 600 # 0.3 is too short at 9600 baud; possible: from 0.35
identify_every_s = «0.5              # 0.5 is too small; possible: number from 1 to 86400
[serial.0.rs485]
delay_before_ms = «101               # 101 is too large
[serial.1]
device = «"/dev/ttyS0"               # is already used by serial.0; choose another port
device = «"/dev/../dev/ttyS0"        # is already used by serial.0; choose another port
«unit_id = 1 # it is a key of [modbus_tcp] and of [[serial]] with speaks = "modbus_rtu"
parity = «"mark"                     # possible: "none" or "even" or "odd"
«checked = true                      # with speaks = "telegram"
[lamps]
lines = ["LED_FRONT", «"LED_FRONT"]  # .1: is already the line of lamps.lines.0; choose another
lines = «[]                          # a list has too few elements; possible: list of 1 or more
[indicators]
error = «"LED_REAR"                  # is already the line of lamps.lines.1; choose another
ok = «"GPIO6"                        # is already the line of indicators.error; choose another
[inclinometer]
driver = «"balluff"                  # possible: "balluff_bsi_r11a0" or "witm
device = «"/dev/ttyS1"               # is already used by serial.1; choose another port
max_roll_deg = «180.0                # number above 0 to 90
device = «"ttyUSB1"                  # "ttyUSB1" is not the path of a device
baud = «9601                         # 9601 is not possible; possible: 4800 or 9600 or 19200
baud = «"19200"                      # "19200" is text; possible: 4800 or 9600 or 19200
parity = «"mark"                     # possible: "none" or "even" or "odd"
stop_bits = «3                       # 3 is not possible; possible: 1 or 2
stop_bits = «true                    # true is not a number; possible: 1 or 2
address = «0                         # 0 is too small; possible: whole number from 1 to 247
address = «248                       # 248 is too large
interval_s = «0.01                   # 0.01 is too small; possible: number from 0.05 to 10
interval_s = «11                     # 11 is too large
max_age_s = «0.1                     # 0.1 is too small; possible: number from 0.2
max_age_s = «61                      # 61 is too large
max_age_s = «0.3                     # possible: from 0.45
frozen_after_s = «0.1                # 0.1 is too small; possible: number from 0.2 to 600
frozen_after_s = «0.4                # 0.4 is too short for readings each 0.15 s; possible: from 0.45
frozen_after_s = «601                # 601 is too large
max_noise_deg = «0                   # 0 is too small; possible: number above 0 to 10
max_noise_deg = «10.5                # 10.5 is too large
max_roll_deg = «0.0                  # 0.0 is too small
max_roll_deg = «"30°"                # is not a number
sign_roll = «0                       # 0 is not possible; possible: -1 or 1
sign_roll = «true                    # true is not a number; possible: -1 or 1
sign_pitch = «"-"                    # "-" is not possible; possible: -1 or 1
offset_roll_deg = «181               # 181 is too large; possible: number from -180 to 180
offset_pitch_deg = «-181.0           # -181.0 is too small
divergence_sigmas = «0.5             # 0.5 is too small; possible: number from 1 to 10
divergence = «"error"                # possible: "invalid" or "warning"
offset_sigma_deg = «-0.1             # -0.1 is too small; possible: number from 0 to 10
level = «3                           # 3 is not a path
sensor = «3                          # 3 is not a table
driver = «"modbus"                   # "modbus" needs the table [inclinometer.sensor]
«max_rol_deg = 3                     # did you mean `
-device                              # this key is missing; possible: path
[thermometers.0]
max_celsius = «-10.0                 # possible: above -10
driver = «"hwmn"                     # "hwmn" is not possible; possible:
name = «"Housing"                    # characters that are not allowed
chip = «""                           # "" is too short
max_celsius = «201                   # 201 is too large
-driver                              # this key is missing
-name                                # this key is missing
-chip                                # this key is missing; possible: text
[thermometers.1]
name = «"housing"                    # is already the name of thermometers.0; choose another
channel = «0                         # 0 is too small
channel = «100                       # 100 is too large; possible: whole number from 1
min_celsius = «-101                  # -101 is too small
max_celsius; min_celsius = 60.0      # 60 is not warmer; possible: above 60
[maintenance]
calibration_due_days = «0            # above 0
calibration_due_days = «36501        # 36501 is too large
calibration_due_days = «2026-11-21   # 2026-11-21 is not a number
min_light_share = «1.0               # 1.0 is too large; possible: number from 0 to below 1
min_light_share = «-0.1              # -0.1 is too small
max_dust_share = «0.0                # 0 is too small; possible: number above 0 to 1
max_dust_share = «1.5                # 1.5 is too large
max_residual_share = «0              # 0 is too small; possible: number above 0 to 1
max_residual_share = «1.1            # 1.1 is too large
«min_light = 0.5                     # did you mean `min_light_share`?
[stage]
device = «"/dev/ttyS1"               # is already used by serial.1; choose another port
start = «"homing"                    # did you mean `home`?
feed_mm_per_min = «0                 # possible: number above 0
«speed = 3                           # there is no such key
sign_x = «0                          # 0 is not possible; possible: -1 or 1
[scan]
columns = «3                         # 3 is too small; possible: whole number from 4 to 64
order = «"spiral"                    # "spiral" is not possible; possible: "serpentine" or "rows"
turned_deg = «90                     # possible: 0 or 180
[scan.limits]
stage_scale_ppm = «-1                # -1 is too small
[self_check]
enabled = «2                         # 2 is neither true nor false; possible: true or false
interval_s = «9.9                    # 9.9 is too small; possible: number from 10 to 86400
interval_s = «86401                  # 86401 is too large
exposures = «1                       # 1 is too small; possible: whole number from 2 to 20
exposures = «21                      # 21 is too large
exposures = «4.5                     # 4.5 is not a whole number
exposures = «"4" # "4" is text; possible: whole number from 2 to 20; write it without quotes
enabled = «"true"                    # "true" is text; possible: true or false; write it without quotes
suspect_mm = «0                      # 0 is too small; possible: number above 0 to 10
suspect_mm = «0.2                    # 0.2 is above bad_mm; possible: up to 0.1
suspect_deg = «-0.01                 # -0.01 is too small; possible: number above 0 to 10
suspect_deg = «0.04                  # 0.04 is above bad_deg; possible: up to 0.03
bad_mm = «10.1                       # 10.1 is too large; possible: number above 0 to 10
bad_mm = «"0.1 mm"                   # "0.1 mm" is not a number
bad_deg = «11                        # 11 is too large
when_bad = «"invlid" # "invlid" is not possible; possible: "invalid" or "warning"; did you mean
when_bad = «"ignore"                 # possible: "invalid" or "warning"
when_unknown = «false                # false is not possible; possible: "invalid" or "warning"
when_unknown = «"good"               # "good" is not possible
compensate = «0.5                    # 0.5 is neither true nor false
compensate_mm = «0.0                 # 0.0 is too small; possible: number above 0 to 10
compensate_mm = «100                 # 100 is too large
«intervall_s = 60                    # did you mean `interval_s`?
"""
"""A fault a line, below its table, and behind # words of the complaint about the first key of the line.

Words behind a point, as in ``.0: is not a network``, are about what is in the value. Lines between "; " each
replace that of their key in the base, or are added at the end of the table; "-" takes away that of a key.
"""

_CAMERA_LAMPS = '[lamps]\ndriver = "camera"\n'
_GPIOD_LAMPS = '[lamps]\ndriver = "gpiod"\nchip = "pinctrl-bcm2711"\nlines = ["LED_FRONT", "LED_REAR"]'
_FRONT = BASE[BASE.index("[cameras.front]") : BASE.index("[cameras.rear]")]
_RECORDING = '[cameras.front]\ndriver = «"recording"\npath = "rec"\n\n'
_NAMES = ("", " ", "unit.example", "1.2.3", "300.1.1.1", "0.0.0.0:80", "*")

OTHERS: tuple[tuple[str, str, str, str], ...] = (
    ('[unit]\nserial = "TEST-1"', "«[unit]", "unit.serial", "this key is missing"),
    ("[unit]", "«[uint]", "uint", "no such table;"),
    (
        "[self_check]\n",
        "[self_check]\ncompensate = true\n[installation.expansion]\nview_ppm_per_k = «9\n",
        "installation.expansion.view_ppm_per_k",
        "the self-check corrects the views already; possible: 0, or compensate = false",
    ),
    ("[measuring]", "«[chain]\n\n[measuring]", "chain", 'is for instrument = "chain"'),
    (
        '[cameras.front]\ndriver = "v4l2"',
        "«[cameras.front]",
        "cameras.front.driver",
        'missing; possible: "recording"',
    ),
    (
        "[cameras.rear.exposure]",
        "«[cameras.rear.exposrue]",
        "cameras.rear.exposrue",
        "did you mean `exposure`?",
    ),
    (
        "[cameras.rear]",
        '«[cameras.spare]\ndriver = "aravis"\ndevice = "1"\n\n[cameras.rear]',
        "cameras.spare",
        "no target",
    ),
    (_FRONT, _RECORDING, "cameras.front.driver", '"recording" does not go with the live camera "rear"'),
    (
        "[opcua]",
        "store_and_forward = «true\n[history]\nenabled = false\n[opcua]",
        "mqtt.store_and_forward",
        "needs the history; possible: enabled = true in [history]",
    ),
    (
        '[[serial]]\ndevice = "/dev/ttyS0"\nspeaks = "telegram"',
        '«[[serial]]\ndevice = "/dev/ttyS0"',
        "serial.0.speaks",
        'this key is missing; possible: "telegram" or "console" or "modbus_rtu"',
    ),
    (_GPIOD_LAMPS, _CAMERA_LAMPS + 'cameras = [«"front"]', "lamps.cameras.0", '"front" has no output'),
    (_GPIOD_LAMPS, _CAMERA_LAMPS + 'cameras = [«"raer"]', "lamps.cameras.0", "did you mean `rear`?"),
    ("[self_check]", "«[selfcheck]", "selfcheck", "there is no such table; possible:"),
    (
        '[inclinometer]\ndriver = "balluff_bsi_r11a0"\n',
        "«[inclinometer]\n",
        "inclinometer.driver",
        'this key is missing; possible: "balluff_bsi_r11a0" or',
    ),
    *(
        (
            '[inclinometer]\ndriver = "balluff_bsi_r11a0"\n',
            f'[inclinometer]\ndriver = "modbus"\n{_sensor(old, new)}\n',
            f"inclinometer.sensor.{key}",
            words,
        )
        for old, new, key, words in (
            ("limit_deg = 0.01", "limit_deg = «0", "limit_deg", "0 is too small; possible: number above 0"),
            ("to_c = 60", "to_c = «-30", "to_c", "-30 is not above from_c = -20"),
            ('"identity"', '«"serial"', "registers.2.use", '"serial" is not possible'),
            (", must_be = 3", "", "registers.2.must_be", 'belongs to use = "identity"'),
            ("scale = 0.01", "scale = «0.0", "registers.1.scale", "0 would make every angle 0"),
            ("«", "", "registers", '2 with use = "roll"; possible: 1'),
            ('"s32"', '«"s64"', "registers.0.type", '"s64" is not possible; possible: "u16" or'),
        )
    ),
    (
        'socket = "/run/altd/altd.sock"',
        f'socket = «"/run/{"x" * 103}"',
        "local.socket",
        "108 bytes are too long for a socket; possible: up to 107",
    ),
    (
        'speaks = "console"',
        'speaks = "console"\n«interval_s = 1.0',
        "serial.1.interval_s",
        "no such key; possible: baud, device, parity, rs485, speaks, stop_bits; "
        'it is a key of [[serial]] with speaks = "telegram"',
    ),
    (
        'error = "GPIO6"\nok = "GPIO19"\n',
        "",
        "indicators",
        "no lamp has a line; possible: data, error, power, ok",
    ),
    *(
        (
            f'[{face}]\nhost = "0.0.0.0"',
            f'[{face}]\nhost = «"{host}"',
            f"{face}.host",
            f'"{host}" is not an IP address; possible: an IP address of',
        )
        for face in ("http", "modbus_tcp")
        for host in _NAMES
    ),
)
"""Faults of names and of several lines: what is replaced, what by, the key, words of the complaint."""

_FRONT_TARGET = BASE[BASE.index("[[targets]]") : BASE.rindex("[[targets]]") + 2]

NO_TOML: tuple[tuple[str, str, str], ...] = (
    ("[unit]", "[unit«", "the ] after the name of a table is missing"),
    ('serial = "TEST-1"', 'serial = "TEST-1«', "the text in quotes does not end on its line"),
    ('serial = "TEST-1"', "serial = «TEST-1", "no value: put text in quotes"),
    ("window = 20", "window = 20 «exposures", "a number is written without its unit"),
    ("window = 20", "window = 20«fps", "a number is written without its unit"),
    ("window = 20", "window = 20 «21", "the line should end here"),
    ("offset_yaw_deg = 0.25", "offset_yaw_deg = 0«,25", "the decimal sign is a point"),
    ("offset_yaw_deg = 0.25", "offset_yaw_deg = 0.25«°", "a number is written without its unit"),
    ('serial = "TEST-1"', "serial = «“TEST-1”", "these quotes are not straight"),
    ('serial = "TEST-1"', r'serial = "C:\P«rogram Files"', "put the text in single quotes"),
    ('serial = "TEST-1"', r'serial = "C:\U«sers"', "put the text in single quotes"),
    (
        _FRONT_TARGET,
        _FRONT_TARGET[1:].replace("]]", "]", 1).replace("\n[[", "\n«[["),
        "[[ ]] here a list of tables: write both alike",
    ),
    ("window = 20", "window «20", "the = after a key is missing"),
    ("window = 20\nevery = 1", "window = 20\n«window = 21", "this key is defined twice"),
    ("[http]", "«[modbus_tcp]", "this table is defined twice"),
    ('["LED_FRONT", "LED_REAR"]', '["LED_FRONT" «"LED_REAR"]', "a comma or ] is missing in a list"),
    ("{ gain = 16 }", "{ gain = 16«", "a comma or } is missing in a table"),
    ("active_low = false", "active_low = «False", "true and false in small letters"),
)
"""Texts that are no TOML: the text replaced, its replacement, words of the complaint."""
