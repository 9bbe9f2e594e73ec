"""Ends with the status it is given, or never when that is negative."""

import sys
import time

print("before the end")
status = int(sys.argv[1])
while status < 0:
    time.sleep(0.1)
sys.exit(status)
