"""A config made by hand that is good and has every table."""

from support.unit_toml import unit_toml

_FRONT_CAMERA = """
driver = "v4l2"
device = "/dev/video0"
width = 752
fps = 20
pixel_format = "GREY"
controls = { gain = 16 }
"""
_REAR_CAMERA = """
driver = "aravis"
device = "192.168.77.20"
height = 480
trigger = "free"
packet_bytes = 1500
features = { Gamma = 1.0 }
min_celsius = -5.0

[cameras.rear.exposure]
control = "auto"
exposure_ms = 2.0
shortest_ms = 0.05
longest_ms = 20.0
gain_db = 0.0
"""
_MORE = """\
[measuring]
window = 20
every = 1
pair_by = "time"
max_skew_ms = 10.0
silent_after_s = 0.4
stale_after_s = 1.0

[installation]
sign_x = -1
offset_x_mm = 12.5
offset_yaw_deg = 0.25
thermometer = "housing"

[machine]
mount_sigma_deg = 0.02

[[machine.points]]
name = "cutterhead"
x_mm = 0.0
y_mm = -1250.0
z_mm = 4800.0
sigma_mm = 1.0

[[machine.points]]
name = "tail"
x_mm = 0.0
y_mm = -1250.0
z_mm = -3100.0
sigma_mm = 1.0

[modbus_tcp]
host = "0.0.0.0"
port = 502
unit_id = 1
reserved = ["192.168.1.10"]
allow_zero = true
certificate = "modbus-unit.pem"
key = "modbus-unit.key"
client_ca = "controllers.pem"
roles = ["operator"]

[http]
host = "0.0.0.0"
port = 8080
allow = ["10.0.0.0/8", "fd00::/8"]
names = ["alt-0007.plant.example"]
credentials = "credentials"
certificate = "unit.pem"
key = "unit.key"

[mqtt]
host = "broker.plant.example"
port = 8884
topic = "plant/line-4"
every_measurement = true
home_assistant = "homeassistant"
ca = "plant-ca.pem"
certificate = "broker-unit.pem"
key = "broker-unit.key"
credentials = "mqtt-login"

[opcua]
host = "0.0.0.0"
port = 4841
certificate = "opcua.pem"
key = "opcua.key"
credentials = "opcua-users"
allow_self_check = true

[local]
socket = "/run/altd/altd.sock"

[[serial]]
device = "/dev/ttyS0"
speaks = "telegram"
baud = 9600
interval_s = 1.0

[serial.rs485]
delay_before_ms = 1

[[serial]]
device = "/dev/ttyS1"
speaks = "console"
parity = "none"

[lamps]
driver = "gpiod"
chip = "pinctrl-bcm2711"
lines = ["LED_FRONT", "LED_REAR"]

[indicators]
driver = "gpiod"
chip = "pinctrl-bcm2711"
error = "GPIO6"
ok = "GPIO19"
active_low = false

[self_check]

[inclinometer]
driver = "balluff_bsi_r11a0"
device = "/dev/ttyUSB1"
max_age_s = 0.8
max_roll_deg = 30.0

[[thermometers]]
driver = "hwmon"
name = "housing"
chip = "tmp102"
max_celsius = 55.0

[[thermometers]]
driver = "hwmon"
name = "outside"
chip = "tmp102"
channel = 2

[maintenance]
calibration_due_days = 180.0

[stage]
driver = "grbl"
device = "/dev/ttyUSB0"
start = "home"
feed_mm_per_min = 1000.0

[scan]
columns = 6
pitch_mm = 25.0
order = "serpentine"
turned_deg = 180
seat_mm_per_m = 0.05
deflection_yaw_deg = 2.0
deflection_sigma_deg = 0.001

[scan.limits]
stage_scale_ppm = 50.0
"""
BASE = unit_toml("TEST-1", "cal.json", _FRONT_CAMERA, _REAR_CAMERA, _MORE)
