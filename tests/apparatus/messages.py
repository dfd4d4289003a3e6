"""Messages as rosbags serialises them."""

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)


def serialise(msgtype: str, fields: dict, *, little_endian: bool = True) -> bytes:
    """Serialise through rosbags; nested messages as dictionaries, all else zero."""

    def build(name: str, given: dict):
        values = []
        for field, (node, description) in STORE.fielddefs[name][1]:
            if node == 2:
                values.append(build(description, given.get(field, {})))
            elif node == 3:
                values.append(np.zeros(description[1]))
            else:
                values.append(given.get(field, "" if description[0] == "string" else 0))
        return STORE.types[name](*values)

    return bytes(STORE.serialize_cdr(build(msgtype, fields), msgtype, little_endian=little_endian))
