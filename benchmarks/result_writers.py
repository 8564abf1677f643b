"""Files of a result as other programs write them, or with something in them twice; see `result_mutations.py`.

What says the same may pass, what says two things may not.
"""

from __future__ import annotations

import io
import json
import random
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from skd_evaluator.campaign.store.manifest import MANIFEST

_NUMBER = re.compile(r'"(margin|deformation|skd|hit_rate|risk_1|collision_rate|seed|eta_max)": ([-0-9.e]+)')


def mutate_text(folder: Path, draw: random.Random) -> str:
    """Write assessment.json in another way, or an entry twice."""
    path = folder / "assessment.json"
    text = path.read_text()
    kind = draw.choice(
        [
            "twice, ours last",
            "twice, ours first",
            "another case",
            "UTF-16",
            "mark",
            "sorted",
            "exponents",
            "after",
            "link",
        ]
    )
    found = draw.choice(list(_NUMBER.finditer(text)))
    other = f'"{found[1]}": {float(found[2]) * 2 + 1:g}'
    if kind == "twice, ours last":
        text = text[: found.start()] + f"{other}, " + text[found.start() :]
    elif kind == "twice, ours first":
        text = text[: found.end()] + f", {other}" + text[found.end() :]
    elif kind == "another case":
        text = text[: found.end()] + f", {other.replace(found[1], found[1].title())}" + text[found.end() :]
    elif kind == "sorted":
        text = json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))
    elif kind == "exponents":
        text = text[: found.start(2)] + f"{float(found[2]):.17e}" + text[found.end(2) :]
    elif kind == "after":
        text += draw.choice(["{}", "\x00", " // right", "]", "\n\n"])
    if kind == "link":
        path.rename(folder.parent / "elsewhere.json")
        path.symlink_to(folder.parent / "elsewhere.json")
    else:
        path.write_text(text, encoding={"UTF-16": "utf-16", "mark": "utf-8-sig"}.get(kind, "utf-8"))
    return f"text: {kind}, {other}"


def mutate_archive(folder: Path, draw: random.Random) -> str:
    """Write episodes.npz as other programs do, or with an array in it twice."""
    path = folder / "episodes.npz"
    with zipfile.ZipFile(path) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    kind = draw.choice(
        ["packed", "bzip2", "order", "Fortran", "version 2", "extra", "before", "comment", "twice, ours last",
         "twice, ours first", "another case", "bytes after", "big endian", "single"]
    )  # fmt: skip
    name, data = draw.choice(members)
    array = np.load(io.BytesIO(data))
    changed = array * 2 if array.dtype.kind in "fi" else array
    if kind in ("Fortran", "version 2", "big endian", "single"):
        new = np.asfortranarray(array) if kind == "Fortran" else array
        new = array.astype(array.dtype.newbyteorder(">")) if kind == "big endian" else new
        new = array.astype(np.float32) if kind == "single" and array.dtype == np.float64 else new
        stream = io.BytesIO()
        np.lib.format.write_array(stream, new, version=(2, 0) if kind == "version 2" else None)
        members = [(one, stream.getvalue() if one == name else content) for one, content in members]
    elif kind == "order":
        draw.shuffle(members)
    elif kind == "extra":
        members.append(("further.npy", data))
    elif kind == "another case":
        members.append((name.upper(), _saved(changed)))
    elif kind == "twice, ours last":
        members.insert(0, (name, _saved(changed)))
    elif kind == "twice, ours first":
        members.append((name, _saved(changed)))
    elif kind == "bytes after":
        members = [(one, content + b"\0" * 8 * (one == name)) for one, content in members]
    packing = {"packed": zipfile.ZIP_DEFLATED, "bzip2": zipfile.ZIP_BZIP2}.get(kind, zipfile.ZIP_STORED)
    with zipfile.ZipFile(path, "w", packing) as archive:
        for one, content in members:
            archive.writestr(one, content)
        archive.comment = b"of another" if kind == "comment" else b""
    if kind == "before":
        path.write_bytes(b"#!/bin/sh\n" + path.read_bytes())
    return f"archive: {kind}, {name}"


def _saved(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def mutate_manifest(folder: Path, draw: random.Random) -> str:
    """Write the manifest as other programs do, or with another file's line in it."""
    path = folder / MANIFEST
    if not path.exists():
        return f"bytes: {MANIFEST}"
    lines = path.read_text().splitlines()
    kind = draw.choice(
        ["capitals", "binary", "points", "order", "CRLF", "mark", "empty", "comment", "one less", "twice"]
    )
    new = {
        "capitals": [line[:64].upper() + line[64:] for line in lines],
        "binary": [line.replace("  ", " *", 1) for line in lines],
        "points": [line.replace("  ", "  ./", 1) for line in lines],
        "order": draw.sample(lines, len(lines)),
        "empty": [],
        "comment": ["# of mine", *lines],
        "one less": [line for line in lines if not line.endswith(draw.choice(["episodes.npz", "assessment.json"]))],
        "twice": [*lines, draw.choice(lines)],
    }.get(kind, lines)
    ending = "\r\n" if kind == "CRLF" else "\n"
    text = "".join(f"{line}{ending}" for line in new)
    path.write_bytes(text.encode("utf-8-sig" if kind == "mark" else "utf-8"))
    return f"manifest: {kind}"


WRITERS = (mutate_text, mutate_text, mutate_archive, mutate_archive, mutate_manifest)
