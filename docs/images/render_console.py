"""Writes the pictures of docs/live.md: a real console, an emulated robot, a real browser.

    python docs/images/render_console.py

Needs Chromium; takes a minute.
"""

import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from PIL import Image  # noqa: E402

from hil.console.json_files import read  # noqa: E402
from hil.console.stop_server import PAGE  # noqa: E402
from tests.chromium import Browser  # noqa: E402

IMAGES = ROOT / "docs" / "images"
FILLED = {"length_m": "0.5", "duration_s": "30", "feedbacks": "ekf", "cases": "x_line"}


def main():
    """Start, drive, take a picture; kill the page's process, press STOP, take another."""
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-m", "hil", "console", "--json"]
        console = subprocess.Popen(command, cwd=place, stdout=subprocess.PIPE, text=True)
        url = json.loads(console.stdout.readline())["url"]
        frame = f"http://127.0.0.1:{read(Path(place, 'out', 'console', PAGE))['port']}"
        browser = Browser(Path(place, "profile"), 1280, 800)
        try:
            browser.open(url)
            browser.until("document.querySelector('#form #start') !== null", frame, 60.0)
            values = "".join(
                f"document.querySelector('[name={n}]').value = '{v}';" for n, v in FILLED.items()
            )
            start = "same(); document.querySelector('#start').click()"
            browser.ask(f"choose('wall_tracking'); {values} {start}", frame)
            browser.until("parseFloat(document.querySelector('#figures b')?.innerText) > 150", frame, 120.0)
            browser.picture(IMAGES / "console.png")
            console.kill()
            browser.until("!document.getElementById('alone').hidden")
            browser.ask("document.getElementById('stop').click()")
            browser.until("document.getElementById('now').innerText.includes('HELD')")
            time.sleep(1.0)
            browser.picture(IMAGES / "console_stopped.png")
            for name in ("console.png", "console_stopped.png"):
                Image.open(IMAGES / name).quantize(64).save(IMAGES / name, optimize=True)
        finally:
            browser.close()
            console.send_signal(signal.SIGKILL)
            console.communicate()
            subprocess.run([sys.executable, "-m", "hil", "console", "--stop"], cwd=place, check=True)


if __name__ == "__main__":
    main()
