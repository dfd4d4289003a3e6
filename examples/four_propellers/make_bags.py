"""Stand in for a lab: fly a four-propeller craft on the twin, record bags in the lab's own way."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import airpuck

HERE = Path(__file__).parent
POSE, COMMAND = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float32MultiArray"
#: The order of the motors in the array, as in mapping.toml.
ORDER = ("front_left", "rear_left", "rear_right", "front_right")


def fly(seconds: float, seed: int) -> airpuck.Recording:
    """Fly an excitation with a craft that the vehicle file knows only roughly."""
    vehicle = airpuck.read_vehicle(HERE / "vehicle.toml")
    known = {"thrust_N": (0.0, 0.6), "inertia_kg_m2": 6.7e-4}
    nominal = vehicle.nominal.model_copy(update=known)
    truth = airpuck.nominal_model(vehicle.model_copy(update={"nominal": nominal}))
    settings = airpuck.read_twin_settings(HERE / "twin.toml")
    return airpuck.excite(truth, seconds, seed, amplitude=0.6, settings=settings)


def write(recording: airpuck.Recording, folder: Path) -> None:
    """Write poses in mm with y up, and commands in percent in an array without a header."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    pose, command = recording["pose"], recording["command"]
    percent = 100 * command.values[:, [command.columns.index(name) for name in ORDER]]
    empty = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/mocap/puck/pose", POSE, typestore=store)
        for stamp, received, (x, y, yaw) in zip(
            pose.stamp_ns.tolist(), pose.received_ns.tolist(), pose.values.tolist(), strict=True
        ):
            time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            point = types["geometry_msgs/msg/Point"](1e3 * x, 25.0, -1e3 * y)
            turn = types["geometry_msgs/msg/Quaternion"](0, np.sin(yaw / 2), 0, np.cos(yaw / 2))
            message = types[POSE](
                types["std_msgs/msg/Header"](time, "mocap"),
                types["geometry_msgs/msg/Pose"](point, turn),
            )
            bag.write(topic, received, store.serialize_cdr(message, POSE))
        topic = bag.add_connection("/puck/thrust", COMMAND, typestore=store)
        for received, row in zip(command.received_ns.tolist(), percent, strict=True):
            message = types[COMMAND](empty, row.astype(np.float32))
            bag.write(topic, received, store.serialize_cdr(message, COMMAND))


if __name__ == "__main__":
    target, seconds = Path(sys.argv[1]), float(sys.argv[2])
    target.mkdir(parents=True)
    for number, name in enumerate(("training", "validation")):
        write(fly(seconds, seed=number + 1), target / name)
