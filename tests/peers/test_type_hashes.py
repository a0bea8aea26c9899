"""The type hashes written in crates/friction-stage-data/src/message/ are those that rosidl
computes."""

import json
import pathlib
import re
import sys

from type_hashes import type_hashes

SOURCES = pathlib.Path(__file__).resolve().parents[2] / "crates/friction-stage-data/src/message"


def constants():
    """Type name -> hash, as the Rust sources say."""
    found = {}
    for path in SOURCES.glob("*.rs"):
        for package, name, type_hash in re.findall(
            r'PACKAGE: &\'static str = (?:"(\w+)"|PACKAGE);'
            r'\s*const NAME: &\'static str = "(\w+)";\s*'
            r'const TYPE_HASH: &\'static str =\s*"(\w+)"',
            path.read_text(),
        ):
            # Our own package has its name in a constant.
            found[f"{package or 'friction_stage_msgs'}/msg/{name}"] = type_hash
    return found


def test_own_messages_have_the_hash_that_rosidl_computes():
    computed = type_hashes()
    assert len(computed) == 2
    written = constants()
    assert computed == {name: written[name] for name in computed}


def test_standard_messages_have_the_hash_of_their_distribution():
    share = pathlib.Path(sys.prefix) / "share"
    checked = 0
    for name, type_hash in constants().items():
        if name.startswith("friction_stage_msgs/"):
            continue
        description = json.loads((share / f"{name}.json").read_text())
        assert description["type_hashes"][0] == {"type_name": name, "hash_string": type_hash}
        checked += 1
    assert checked == 25
