"""What docs/python.md prints, and the examples."""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import nbclient
import nbformat
import pytest
from conftest import CLUSTER, PATIENCE, ROOT, planned

import cosmic_can

PAGE = ROOT / "docs/python.md"
EXAMPLES = ROOT / "examples/python"
BLOCKS = re.compile(r"```python\n(.*?)```\n```text\n(.*?)```", re.DOTALL)


def test_the_page_prints_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    text = PAGE.read_text()
    blocks = BLOCKS.findall(text)
    assert len(blocks) == text.count("```python")
    names: dict[str, object] = {}
    for code, expected in blocks:
        printed = io.StringIO()
        code = code.replace("/tmp/rover-segment", str(tmp_path / "segment"))
        with contextlib.redirect_stdout(printed):
            exec(compile(code, str(PAGE), "exec"), names)
        assert printed.getvalue() == expected


def start(script: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, str(EXAMPLES / script), *map(str, arguments)]
    environment = {**os.environ, "MPLBACKEND": "agg"}
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def test_scripts_print_events(segment: cosmic_can.Segment) -> None:
    with planned(segment, 4) as imu, planned(segment, 5) as arm:
        for script, channels in [("print_events.py", ["attitude"]), ("watch_two.py", ["attitude", "gripper"])]:
            process = start(script, segment.link, CLUSTER, *channels)
            assert process.stdout is not None
            os.set_blocking(process.stdout.fileno(), False)
            seen = ""
            for _ in range(int(PATIENCE / 0.01)):
                imu.publish("attitude", {"roll": 1, "pitch": 2, "yaw": 3, "quality": 4, "calibrated": False})
                arm.publish("gripper", {"state": "open", "force": 0})
                with contextlib.suppress(TypeError):
                    seen += process.stdout.read() or ""
                if all(f"{channel} from" in seen for channel in channels):
                    break
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(0.01)
            process.kill()
            process.wait()
            process.stdout.close()
            assert "attitude from imu: roll=1 ° pitch=2 °" in seen
            assert ("gripper from arm: state=open force=0 N" in seen) == ("gripper" in channels)


def test_a_script_publishes_with_a_deadline(segment: cosmic_can.Segment) -> None:
    with planned(segment, 5):
        # There is no broker, so it gets the name of a node that is planned.
        code = (EXAMPLES / "move_joint.py").read_text()
        code = code.replace("cluster=cluster)", "cluster=cluster, uid=0xB0A0000000000001)")
        command = [sys.executable, "-c", code, segment.link, str(CLUSTER), "2", "0.5"]
        printed = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
        # Which of the two, on a busy machine, nobody knows.
        assert printed in ("sent\n", "too late: not sent\n")


def test_a_script_plots_a_log(tmp_path: Path) -> None:
    picture = tmp_path / "speed.svg"
    log = ROOT / "docs/tasks/late.log"
    assert start("plot_wheel_speed.py", log, CLUSTER, "left_wheel", picture).wait(PATIENCE) == 0
    assert "<svg" in picture.read_text()


def test_the_notebook_runs() -> None:
    notebook = nbformat.read(EXAMPLES / "wheel_speed.ipynb", as_version=4)
    resources = {"metadata": {"path": str(EXAMPLES)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    shown = [output["data"] for cell in notebook.cells for output in cell.get("outputs", []) if "data" in output]
    assert any("image/png" in data for data in shown) and any("text/html" in data for data in shown)
    source = (EXAMPLES / "wheel_speed.ipynb").read_text()
    assert '"image/png"' not in source, "it is kept without its outputs"
