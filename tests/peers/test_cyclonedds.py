"""A participant of another DDS vendor reads the stage."""

import json
import sys
from pathlib import Path

from friction_stage_testing import Process
from ros import nanoseconds

COUNT = 500


def test_cyclone_dds_reads_the_encoder_as_rclpy_does(domain, processes, ros, stage, tmp_path):
    stage(mode="realtime", control_rate=1000.0)
    encoder = ros.collect("/stage/encoder")
    script = Path(__file__).with_name("cyclone_reader.py")
    reader = Process(
        [sys.executable, str(script), str(domain), str(COUNT)], tmp_path / "cyclone.log"
    )
    processes.append(reader)
    ros.until(lambda: reader.popen.poll() is not None, f"{COUNT} samples in Cyclone DDS")
    ros.until(lambda: len(encoder) > COUNT, "the same in rclpy")
    reader.ended(expected=0)

    assert reader.log().count("\n") == COUNT + 1
    samples = [json.loads(line) for line in reader.log().splitlines()[1:]]
    stamps = [sample[0] for sample in samples]
    assert stamps == list(range(stamps[0], stamps[0] + COUNT * 1_000_000, 1_000_000)), (
        "samples were lost"
    )
    heard = {
        nanoseconds(m.header.stamp): (m.name, m.position, m.velocity, m.effort) for m in encoder
    }
    common = [sample for sample in samples if sample[0] in heard]
    assert len(common) > COUNT / 2
    for stamp, *fields in common:
        assert fields == [list(field) for field in heard[stamp]]
