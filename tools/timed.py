"""Run a compiler, and write the seconds of a processor that it took beside what it makes: ``python timed.py c++ …``."""

import os
import subprocess
import sys

code = subprocess.call(sys.argv[1:])
if code == 0 and "-o" in sys.argv:
    used = os.times()
    with open(sys.argv[sys.argv.index("-o") + 1] + ".seconds", "w", encoding="ascii") as file:
        file.write(f"{used.children_user + used.children_system:.2f}\n")
sys.exit(code)
