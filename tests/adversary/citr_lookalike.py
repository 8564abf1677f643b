"""Files of the format and naming of CITR's `vci_lat_uni`, from walks that are known in closed form.

A look-alike is described in the world frame (cart North on x = 0, pedestrian East, crossing x = 0 at y = 0),
and then turned, mirrored and moved into a frame of the dataset's kind.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

FRAME_RATE = 29.97


@dataclass(frozen=True)
class Walk:
    """A straight walk (start_x + v·t, north + drift·x) with a sideways sway of its own frequency."""

    start_x: float = -4.0
    speed: float = 1.4
    drift: float = 0.1
    sway: float = 0.2
    north: float = 0.0

    def at(self, seconds: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        x = self.start_x + self.speed * seconds
        y = self.north + self.drift * x + self.sway * np.sin(x)
        return np.column_stack([x, y])


@dataclass(frozen=True)
class LookAlike:
    """One clip. The cart drives North from `cart_y` at `cart_speed`; `side` −1 mirrors East and West."""

    name: str = "unidirection_yeild_01"
    walks: Sequence[Walk] = (Walk(),)
    cart_y: float = -20.0
    cart_speed: float = 2.0
    direction: float = math.radians(178.0)
    side: int = 1
    centre: tuple[float, float] = (17.0, 8.0)
    first_frame: int = 105
    frames: int = 200

    def seconds(self) -> npt.NDArray[np.float64]:
        return np.arange(self.frames) / FRAME_RATE

    def to_dataset(self, world: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        north = np.array([math.cos(self.direction), math.sin(self.direction)])
        east = self.side * np.array([north[1], -north[0]])
        return world[:, :1] * east + world[:, 1:] * north + np.array(self.centre)

    def write(self, folder: Path) -> None:
        t = self.seconds()
        rows = ["id,frame,label,x_est,y_est,vx_est,vy_est"]
        for id_, walk in enumerate(self.walks, start=1):
            points = self.to_dataset(walk.at(t))
            velocities = np.gradient(points, 1.0 / FRAME_RATE, axis=0)
            rows += [
                f"{id_},{self.first_frame + i},ped,{p[0]!r},{p[1]!r},{v[0]!r},{v[1]!r}"
                for i, (p, v) in enumerate(zip(points.tolist(), velocities.tolist(), strict=True))
            ]
        (folder / f"{self.name}_traj_ped_filtered.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        cart = self.to_dataset(np.column_stack([np.zeros_like(t), self.cart_y + self.cart_speed * t]))
        rows = ["id,frame,label,x_est,y_est,psi_est,vel_est"]
        rows += [
            f"1,{self.first_frame + i},veh,{p[0]!r},{p[1]!r},{self.direction!r},{self.cart_speed!r}"
            for i, p in enumerate(cart.tolist())
        ]
        (folder / f"{self.name}_traj_veh_filtered.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
