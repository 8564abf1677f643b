"""What a node of rclpy leaves when it is destroyed, without anything of SKD's in it.

    .venv/bin/python -m skd_sim.ros_environment .venv/bin/python benchmarks/destroyed_nodes.py

Makes empty nodes in a context that lives on, destroys each at once, and prints what the C library has handed out.
"""

from __future__ import annotations

import gc

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from soak import heap

EACH, ROUNDS = 20, 4


def main() -> None:
    """Print kB after every 20 nodes."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=77)
    keeper = Node("keeper", context=context, start_parameter_services=False, enable_rosout=False)
    for done in range(EACH, EACH * ROUNDS + 1, EACH):
        for number in range(EACH):
            node = Node(f"node_{number}", context=context, start_parameter_services=False, enable_rosout=False)
            node.destroy_node()
        gc.collect()
        now = heap()
        print(f"{done} nodes: {(now.uordblks + now.hblkhd) // 1024} kB handed out", flush=True)
    keeper.destroy_node()
    rclpy.try_shutdown(context=context)


if __name__ == "__main__":
    main()
