"""Lays out noctule's wire types with ctypes, from the order and the types of their fields alone.

In, on stdin: the JSON of `noctule topics --json`. Out: for each type name its size, its alignment, the offset of each
field, and the schema hash of that layout. Never looks at an offset, size or hash of its input, so that it can disagree.
"""

import ctypes
import json
import sys

C_TYPES = {
    "u8": ctypes.c_uint8,
    "i16": ctypes.c_int16,
    "u32": ctypes.c_uint32,
    "u64": ctypes.c_uint64,
    "f32": ctypes.c_float,
    "f64": ctypes.c_double,
}


def fnv1a_64(text):
    value = 0xCBF29CE484222325
    for byte in text.encode():
        value = ((value ^ byte) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return value


def lay_out(type_name, fields):
    class Laid(ctypes.Structure):
        _fields_ = [
            (f["name"], C_TYPES[f["type"]] * f["count"] if f["count"] > 1 else C_TYPES[f["type"]]) for f in fields
        ]

    offsets = {f["name"]: getattr(Laid, f["name"]).offset for f in fields}
    text = "".join(f"{f['name']}@{offsets[f['name']]}:{f['type']}*{f['count']};" for f in fields)
    return {
        "size": ctypes.sizeof(Laid),
        "alignment": ctypes.alignment(Laid),
        "offsets": offsets,
        "schema_hash": fnv1a_64(f"{type_name}|{text}"),
    }


answer = {}
for service in json.load(sys.stdin)["services"]:
    for described in (service["payload"], service["header"]):
        if described is not None and described["fields"]:
            answer[described["type_name"]] = lay_out(described["type_name"], described["fields"])
json.dump(answer, sys.stdout)
