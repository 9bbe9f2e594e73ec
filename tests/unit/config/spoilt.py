"""Configs made by hand, each with its fault: « marks the place of the fault, and is not in the file.

A case is (what is replaced, what by, the key that is wrong, words of the complaint).
"""

from __future__ import annotations

from .whole_config import BASE

_CAMERA_LAMPS = '[lamps]\ndriver = "camera"\n'
_GPIOD_LAMPS = '[lamps]\ndriver = "gpiod"\nchip = "pinctrl-bcm2711"\nlines = ["LED_FRONT", "LED_REAR"]'
_FRONT = BASE[BASE.index("[cameras.front]") : BASE.index("[cameras.rear]")]
_RECORDING = '[cameras.front]\ndriver = «"recording"\npath = "rec"\n\n'

CASES: tuple[tuple[str, str, str, str], ...] = (
    # [unit]
    ('serial = "TEST-1"', "serial = «4711", "unit.serial", "4711 is not text"),
    ('serial = "TEST-1"', 'serial = «""', "unit.serial", '"" is too short; possible: text, 1 to 64'),
    (
        'serial = "TEST-1"',
        r'serial = «"A\u001b[2J\u202e\nB"',
        "unit.serial",
        r"A\x1b[2J\u202e\nB has a character that is not printable",
    ),
    (
        'serial = "TEST-1"',
        '«serail = "TEST-1"',
        "unit.serail",
        "no such key; possible: calibration, serial; did you",
    ),
    ('[unit]\nserial = "TEST-1"', "«[unit]", "unit.serial", "this key is missing"),
    ('calibration = "cal.json"', "calibration = «3", "unit.calibration", "3 is not a path"),
    ("[unit]", "«[uint]", "uint", "no such table; "),
    # [[targets]]
    ('name = "front"', 'name = «"Front"', "targets.0.name", "has characters that are not allowed"),
    ('name = "rear"', 'name = «"front"', "targets.1.name", '"front" is the name of targets.0 too'),
    ("z_mm = 280.0", 'z_mm = «"far"', "targets.1.z_mm", '"far" is not a number; possible: number from'),
    ("z_mm = 280.0", "z_mm = «0.0", "targets.1.z_mm", "0 is not behind targets.0; possible: above 0"),
    ("z_mm = 280.0", "z_mm = «-280.0", "targets.1.z_mm", "-280 is not behind targets.0"),
    ("z_mm = 0.0", "z_mm = «nan", "targets.0.z_mm", "nan is not a finite number"),
    ('camera = "rear"', 'camera = «"raer"', "targets.1.camera", "no table [cameras.raer]; "),
    ('camera = "rear"', 'camera = «"front"', "targets.1.camera", '"front" is the camera of targets.0 too'),
    # [cameras.…]
    ('driver = "v4l2"', 'driver = «"v4l"', "cameras.front.driver", "did you mean `v4l2`?"),
    (
        '[cameras.front]\ndriver = "v4l2"',
        "«[cameras.front]",
        "cameras.front.driver",
        'missing; possible: "recording"',
    ),
    ('device = "/dev/video0"', 'device = «"video0"', "cameras.front.device", "is no path of a device"),
    (
        "width = 752",
        "width = «32",
        "cameras.front.width",
        "32 is too small; possible: whole number from 64 to 16384",
    ),
    ("width = 752", "width = «752.5", "cameras.front.width", "752.5 is not a whole number"),
    ("fps = 20", "fps = «0", "cameras.front.fps", "0 is too small; possible: number from 1 to 1000"),
    ("fps = 20", "fps = «true", "cameras.front.fps", "true is not a number"),
    (
        "height = 480",
        "height = 480\nfps = «10",
        "cameras.rear.fps",
        '10 is not the rate of camera "front"; possible: 20',
    ),
    ('pixel_format = "GREY"', 'pixel_format = «"Mono8"', "cameras.front.pixel_format", '"GREY" or "Y10" or'),
    ("{ gain = 16 }", '{ gain = «"much" }', "cameras.front.controls.gain", '"much" is not a whole number'),
    ("{ gain = 16 }", "«16", "cameras.front.controls", "16 is no table"),
    (
        "{ Gamma = 1.0 }",
        "{ Gamma = «[1.0] }",
        "cameras.rear.features.Gamma",
        "a list cannot be used; possible: number,",
    ),
    ('"192.168.77.20"', '«"300.1.1.1"', "cameras.rear.device", '"300.1.1.1" is no IP address'),
    ('"192.168.77.20"', '«"224.0.0.1"', "cameras.rear.device", "is an address that no camera has"),
    (
        'trigger = "free"',
        'trigger = «"cable"',
        "cameras.rear.trigger",
        'possible: "free" or "software" or "line"',
    ),
    ("packet_bytes = 1500", "packet_bytes = «20000", "cameras.rear.packet_bytes", "20000 is too large"),
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
    # [cameras.….exposure]
    (
        'control = "auto"',
        'control = «"automatic"',
        "cameras.rear.exposure.control",
        "is not possible; possible: ",
    ),
    (
        "exposure_ms = 2.0",
        "exposure_ms = «30.0",
        "cameras.rear.exposure.exposure_ms",
        "from shortest_ms 0.05 to",
    ),
    (
        "gain_db = 0.0",
        "gain_db = «24.0",
        "cameras.rear.exposure.gain_db",
        "possible: up to largest_gain_db 12",
    ),
    (
        'control = "auto"\nexposure_ms = 2.0',
        'control = "fixed"\nexposure_ms = «60.0',
        "cameras.rear.exposure.exposure_ms",
        "60 is longer than from frame to frame; possible: up to 50",
    ),
    # [measuring]
    (
        "window = 20",
        "window = «0",
        "measuring.window",
        "0 is too small; possible: whole number from 1 to 1000",
    ),
    ("window = 20", "«windw = 20", "measuring.windw", "did you mean `window`?"),
    ("every = 1", "every = «2000", "measuring.every", "2000 is too large"),
    (
        'pair_by = "time"',
        'pair_by = «"sequence"',
        "measuring.pair_by",
        '"sequence" is for recordings; possible: "time"',
    ),
    (
        "max_skew_ms = 10.0",
        "max_skew_ms = «-1",
        "measuring.max_skew_ms",
        "-1 is too small; possible: number above 0",
    ),
    ("silent_after_s = 0.4", "silent_after_s = «0.05", "measuring.silent_after_s", "possible: above 0.05"),
    (
        "every = 1",
        "every = 20",
        "measuring.stale_after_s",
        "1 is over before the next value comes; possible: above 1",
    ),
    (
        "every = 1",
        'every = 1\noutput = «"newest"',
        "measuring.output",
        '"newest" is not possible; possible: "mean" or "now"',
    ),
    (
        "window = 20",
        'output = "now"\nwindow = «7',
        "measuring.window",
        '7 exposures are too few for output = "now"; possible: from 8',
    ),
    # [installation]
    ("sign_x = -1", "sign_x = «0", "installation.sign_x", "0 is not possible; possible: -1 or 1"),
    ("offset_x_mm = 12.5", "offset_x_mm = «1e6", "installation.offset_x_mm", "1000000.0 is too large"),
    ("offset_x_mm = 12.5", "offset_x_mm = «true", "installation.offset_x_mm", "true is not a number"),
    ("offset_yaw_deg = 0.25", "offset_yaw_deg = «90", "installation.offset_yaw_deg", "90 is too large"),
    # [modbus_tcp], [http]
    (
        '[modbus_tcp]\nhost = "0.0.0.0"',
        '[modbus_tcp]\nhost = «"300.1.1.1"',
        "modbus_tcp.host",
        "is no IP address",
    ),
    (
        '[modbus_tcp]\nhost = "0.0.0.0"',
        '[modbus_tcp]\nhost = «"224.0.0.1"',
        "modbus_tcp.host",
        "address of groups",
    ),
    (
        '[modbus_tcp]\nhost = "0.0.0.0"',
        '[modbus_tcp]\nhost = «"fe80::1"',
        "modbus_tcp.host",
        "name its interface",
    ),
    ('reserved = ["192', 'reserved = [«"192.168.1.10:502", "192', "modbus_tcp.reserved.0", "is no network"),
    (
        '[http]\nhost = "0.0.0.0"',
        '[http]\nhost = «"240.0.0.1"',
        "http.host",
        "an address that no computer has",
    ),
    ('[http]\nhost = "0.0.0.0"', '[http]\nhost = «"::ffff:10.0.0.1"', "http.host", "write 10.0.0.1"),
    ('allow = ["10.0.0.0/8"', 'allow = [«"10.0.0.1/8"', "http.allow.0", "possible: 10.0.0.0/8"),
    ('allow = ["10.0.0.0/8"', 'allow = [«"plant"', "http.allow.0", "is no network"),
    ('allow = ["10.0.0.0/8"', 'allow = [«"::ffff:10.0.0.0/104"', "http.allow.0", "write it as IPv4"),
    ('names = ["alt-0007', 'names = [«"http://alt-0007', "http.names.0", "is no name of a computer"),
    (
        'allow = ["10.0.0.0/8", "fd00::/8"]',
        'allow = «"10.0.0.0/8"',
        "http.allow",
        '; did you mean `["10.0.0.0/8"]`?',
    ),
    (
        'certificate = "unit.pem"\nkey = "unit.key"',
        'key = «"unit.key"',
        "http.key",
        "is set without certificate",
    ),
    (
        'certificate = "unit.pem"\nkey = "unit.key"',
        'certificate = «"unit.pem"',
        "http.certificate",
        "is set without key",
    ),
    ('credentials = "credentials"', "credentials = «7", "http.credentials", "is not a path"),
    # [mqtt]
    ('host = "broker.plant', 'host = «"mqtt://broker.plant', "mqtt.host", "is no name of a computer"),
    (
        '"broker.plant.example"',
        '«"broker.plant:1883"',
        "mqtt.host",
        "alt-0007.plant, without scheme and port",
    ),
    ('topic = "plant/line-4"', 'topic = "a"\n«password = "b"', "mqtt.password", "`credentials` is its path"),
    ('host = "broker.plant', '«hsot = "broker.plant', "mqtt.hsot", "no such key; "),
    ("port = 8884", "port = «0", "mqtt.port", "0 is too small; possible: whole number from 1 to 65535"),
    (
        'topic = "plant/line-4"',
        'topic = «"plant/#"',
        "mqtt.topic",
        "is no beginning of topics; possible: letters",
    ),
    ('topic = "plant/line-4"', 'topic = «"/plant"', "mqtt.topic", "is no beginning of topics"),
    ('topic = "plant/line-4"', 'topic = «"$SYS"', "mqtt.topic", "is no beginning of topics"),
    ('= "homeassistant"', "= «true", "mqtt.home_assistant", "true is not text"),
    (
        '= "homeassistant"',
        '= «"homeassistant"\nsparkplug = {group = "line-4"}',
        "mqtt.home_assistant",
        "does not go with [mqtt.sparkplug]",
    ),
    ('home_assistant = "homeassistant"', "«sparkplug = {}", "mqtt.sparkplug.group", "is missing"),
    (
        'home_assistant = "homeassistant"',
        'sparkplug = {group = «"plant/4"}',
        "mqtt.sparkplug.group",
        "is no identifier; possible: letters, digits",
    ),
    (
        'home_assistant = "homeassistant"',
        'sparkplug = {group = "4", node = «"+"}',
        "mqtt.sparkplug.node",
        "is no identifier",
    ),
    ('ca = "plant-ca.pem"\n', "", "mqtt.certificate", "is set without ca; possible: both"),
    ('key = "broker-unit.key"\n', "", "mqtt.certificate", "is set without key; possible: both"),
    (
        "every_measurement = true",
        'every_measurement = «"each"',
        "mqtt.every_measurement",
        '"each" is neither true nor false',
    ),
    # [opcua]
    ("port = 4841", "port = «502", "opcua.port", "502 is the port of [modbus_tcp] too"),
    ("port = 4841", "port = «8080", "opcua.port", "8080 is the port of [http] too"),
    ('key = "opcua.key"\n', "", "opcua.certificate", "is set without key; possible: both"),
    (
        'certificate = "opcua.pem"\nkey = "opcua.key"\n',
        "",
        "opcua.credentials",
        "is set without certificate; possible: both",
    ),
    ("port = 8080", "port = «502", "http.port", "502 is the port of [modbus_tcp] too"),
    (
        'client_ca = "controllers.pem"\n',
        "",
        "modbus_tcp.certificate",
        "is set without client_ca; possible: both",
    ),
    (
        'key = "modbus-unit.key"\n',
        "",
        "modbus_tcp.certificate",
        "is set without key; possible: both",
    ),
    (
        'roles = ["operator"]\n',
        "",
        "modbus_tcp.allow_zero",
        "is set without roles; possible: both: over TLS a client needs a role",
    ),
    ('roles = ["operator"]', 'roles = [«""]', "modbus_tcp.roles.0", "is too short"),
    ("allow_zero = true", "allow_zero = «1.5", "modbus_tcp.allow_zero", "1.5 is neither true nor false"),
    (
        "port = 8080",
        "port = «70000",
        "http.port",
        "70000 is too large; possible: whole number from 0 to 65535",
    ),
    (
        "unit_id = 1",
        "unit_id = «248",
        "modbus_tcp.unit_id",
        "248 is too large; possible: whole number from 1 to 247",
    ),
    # [local]
    (
        'socket = "/run/altd/altd.sock"',
        'socket = «"altd.sock"',
        "local.socket",
        '"altd.sock" is no path from the root',
    ),
    (
        'socket = "/run/altd/altd.sock"',
        r'socket = «"/run/\u0007x"',
        "local.socket",
        "is no path from the root",
    ),
    (
        'socket = "/run/altd/altd.sock"',
        f'socket = «"/run/{"x" * 103}"',
        "local.socket",
        "108 bytes are too long for a socket; possible: up to 107",
    ),
    # [[serial]]
    ('device = "/dev/ttyS1"', 'device = «"/dev/ttyS0"', "serial.1.device", "is the port of serial.0 too"),
    (
        'device = "/dev/ttyS1"',
        'device = «"/dev/../dev/ttyS0"',
        "serial.1.device",
        "is the port of serial.0 too",
    ),
    ('speaks = "telegram"', 'speaks = «"telegramm"', "serial.0.speaks", "did you mean `telegram`?"),
    (
        '[[serial]]\ndevice = "/dev/ttyS0"\nspeaks = "telegram"',
        '«[[serial]]\ndevice = "/dev/ttyS0"',
        "serial.0.speaks",
        'this key is missing; possible: "telegram" or "console" or "modbus_rtu"',
    ),
    (
        'speaks = "console"',
        'speaks = "console"\n«interval_s = 1.0',
        "serial.1.interval_s",
        "no such key; possible: baud, device, parity, rs485, speaks, stop_bits; "
        'it is a key of [[serial]] with speaks = "telegram"',
    ),
    (
        'speaks = "console"',
        'speaks = "console"\n«unit_id = 1',
        "serial.1.unit_id",
        'it is a key of [modbus_tcp] and of [[serial]] with speaks = "modbus_rtu"',
    ),
    (
        "width = 752",
        'width = 752\n«trigger = "free"',
        "cameras.front.trigger",
        'it is a key of [cameras.NAME] with driver = "aravis"',
    ),
    ("baud = 9600", "baud = «9601", "serial.0.baud", "9601 is not possible; possible: 1200 or 2400"),
    (
        "interval_s = 1.0",
        "interval_s = «0.1",
        "serial.0.interval_s",
        "0.1 is too short at 9600 baud; possible: from 0.18",
    ),
    (
        "interval_s = 1.0",
        "interval_s = «0.2\nchecked = true",
        "serial.0.interval_s",
        "0.2 is too short at 9600 baud; possible: from 0.26",
    ),
    (
        "interval_s = 1.0",
        "interval_s = «0.3\nchecked = true\nidentify_every_s = 600",
        "serial.0.interval_s",
        "0.3 is too short at 9600 baud; possible: from 0.35",
    ),
    (
        "interval_s = 1.0",
        "interval_s = 1.0\nidentify_every_s = «0.5",
        "serial.0.identify_every_s",
        "0.5 is too small; possible: number from 1 to 86400",
    ),
    ("delay_before_ms = 1", "delay_before_ms = «101", "serial.0.rs485.delay_before_ms", "101 is too large"),
    ('parity = "none"', 'parity = «"mark"', "serial.1.parity", 'possible: "none" or "even" or "odd"'),
    # [lamps], [indicators]
    (
        '["LED_FRONT", "LED_REAR"]',
        '["LED_FRONT", «"LED_FRONT"]',
        "lamps.lines.1",
        "is the line of lamps.lines.0 too",
    ),
    ('["LED_FRONT", "LED_REAR"]', "«[]", "lamps.lines", "too few elements; possible: list of 1 or more"),
    ('error = "GPIO6"', 'error = «"LED_REAR"', "indicators.error", "is the line of lamps.lines.1 too"),
    ('ok = "GPIO19"', 'ok = «"GPIO6"', "indicators.ok", "is the line of indicators.error too"),
    ("active_low = false", "active_low = «2", "indicators.active_low", "2 is neither true nor false"),
    (_GPIOD_LAMPS, _CAMERA_LAMPS + 'cameras = [«"front"]', "lamps.cameras.0", '"front" has no output'),
    (_GPIOD_LAMPS, _CAMERA_LAMPS + 'cameras = [«"raer"]', "lamps.cameras.0", "did you mean `rear`?"),
    # [inclinometer]
    (
        '[inclinometer]\ndriver = "balluff_bsi_r11a0"',
        '[inclinometer]\ndriver = «"balluff"',
        "inclinometer.driver",
        'possible: "balluff_bsi_r11a0" or "witm',
    ),
    ('"/dev/ttyUSB1"', '«"/dev/ttyS1"', "inclinometer.device", "is the port of serial.1 too"),
    ("max_age_s = 0.8", "max_age_s = «0.3", "inclinometer.max_age_s", "possible: from 0.45"),
    ("max_roll_deg = 30.0", "max_roll_deg = «180.0", "inclinometer.max_roll_deg", "number above 0 to 90"),
    # [[thermometers]], [maintenance]
    (
        "min_celsius = -5.0",
        "min_celsius = -5.0\nmax_celsius = «-6.0",
        "cameras.rear.max_celsius",
        "possible: above -5",
    ),
    ('name = "outside"', 'name = «"housing"', "thermometers.1.name", "is the name of thermometers.0 too"),
    ("max_celsius = 55.0", "max_celsius = «-10.0", "thermometers.0.max_celsius", "possible: above -10"),
    ("channel = 2", "channel = «0", "thermometers.1.channel", "0 is too small"),
    (
        "calibration_due_days = 180.0",
        "calibration_due_days = «0",
        "maintenance.calibration_due_days",
        "above 0",
    ),
    # [stage], [scan]
    ('device = "/dev/ttyUSB0"', 'device = «"/dev/ttyS1"', "stage.device", "is the port of serial.1 too"),
    ('start = "home"', 'start = «"homing"', "stage.start", "did you mean `home`?"),
    ("feed_mm_per_min = 1000.0", "feed_mm_per_min = «0", "stage.feed_mm_per_min", "possible: number above 0"),
    ("columns = 6", "columns = «3", "scan.columns", "3 is too small; possible: whole number from 4 to 64"),
    ('order = "serpentine"', 'order = «"spiral"', "scan.order", 'possible: "serpentine" or "rows"'),
)
