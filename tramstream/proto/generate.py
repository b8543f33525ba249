"""Compile the `.proto` files beside this: `python -m tramstream.proto.generate [OUT_DIR]`."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent.parent


def generate(out_dir: Path) -> list[Path]:
    """Write `_pb2.py` and `_pb2.pyi` of every `.proto` below `out_dir`; return their paths."""
    from grpc_tools import protoc

    protos = sorted(HERE.glob("*.proto"))
    names = [str(path.relative_to(ROOT)) for path in protos]
    argv = ["protoc", f"-I{ROOT}", f"--python_out={out_dir}", f"--pyi_out={out_dir}", *names]
    if protoc.main(argv) != 0:
        raise RuntimeError("protoc refused the .proto files; its message is above")
    folder = out_dir / "tramstream" / "proto"
    return [folder / f"{path.stem}_pb2{end}" for path in protos for end in (".py", ".pyi")]


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
