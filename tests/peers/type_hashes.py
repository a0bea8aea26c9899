"""RIHS01 type hashes of our own messages, computed by rosidl itself.

Runs in a virtual environment that holds the wheels of rosidl and of the standard messages:

    python tests/peers/type_hashes.py        # {"friction_stage_msgs/msg/StageState": "RIHS01_...",
      ...}

The constants in crates/friction-stage-data/src/message/friction_stage_msgs.rs must equal what this
prints.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

PACKAGE = "friction_stage_msgs"
MESSAGES = pathlib.Path(__file__).resolve().parents[2] / "msg"

# rosidl wheels load shared libraries and restart the interpreter unless told that this is done.
PROGRAM = """
import json, pathlib, sys
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_generator_type_description import generate_type_hash
source, work, share, package = map(pathlib.Path, sys.argv[1:])
package = str(package)
(work / "msg").mkdir()
names = sorted(p.name for p in source.glob("*.msg"))
tuples = []
for name in names:
    (work / "msg" / name).write_text((source / name).read_text())
    convert_msg_to_idl(work, package, pathlib.Path("msg") / name, work / "msg")
    tuples.append(f"{work}:msg/{pathlib.Path(name).stem}.idl")
arguments = work / "arguments.json"
arguments.write_text(json.dumps({
    "package_name": package,
    "output_dir": str(work / "out"),
    "idl_tuples": tuples,
    "include_paths": [f"{d.name}:{d}" for d in share.iterdir() if (d / "msg").is_dir()],
}))
for path in generate_type_hash(str(arguments)):
    first = json.loads(pathlib.Path(path).read_text())["type_hashes"][0]
    print(json.dumps([first["type_name"], first["hash_string"]]))
"""


def type_hashes(prefix=sys.prefix):
    """Type name -> RIHS01 hash for every message of this package; `prefix` is the virtual
    environment."""
    prefix = pathlib.Path(prefix)
    python = prefix / "bin" / "python"
    with tempfile.TemporaryDirectory() as work:
        lines = subprocess.run(
            [python, "-c", PROGRAM, MESSAGES, work, prefix / "share", PACKAGE],
            check=True,
            capture_output=True,
            text=True,
        ).stdout.splitlines()
    return dict(json.loads(line) for line in lines if line.startswith("["))


if __name__ == "__main__":
    print(json.dumps(type_hashes(), indent=2))
