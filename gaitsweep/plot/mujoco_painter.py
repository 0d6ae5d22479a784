"""The process that renders a body with MuJoCo and OpenGL: `python -m gaitsweep.plot.mujoco_painter`.

It reads an .npz from standard input and writes, for each sample, the bytes of an RGB picture to standard
output. It is a process of its own because MuJoCo chooses its OpenGL once, when it is imported, and because a
driver that crashes then takes nothing with it.
"""

from __future__ import annotations

import io
import os
import sys

import mujoco
import numpy as np

_ASIDE, _DOWN = 28.0, -14.0  # degrees: how far the camera stands ahead of the right side, and looks down
_TIGHT = 1.12


def main() -> None:
    given = np.load(io.BytesIO(sys.stdin.buffer.read()))
    pictures = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not come between the pictures
    model = mujoco.MjModel.from_xml_string(str(given["mjcf"]))
    data = mujoco.MjData(model)
    width, height = (int(pixels) for pixels in given["size"])
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    _paint_limbs(model, given["colours"])
    camera = _camera(model, given, width / height)
    renderer = mujoco.Renderer(model, height, width)
    for qpos, middle in zip(given["qpos"], given["middle"], strict=True):
        data.qpos = qpos
        mujoco.mj_forward(model, data)
        camera.lookat[:2] = middle
        renderer.update_scene(data, camera)
        pictures.write(renderer.render().tobytes())
        pictures.flush()
    renderer.close()


def _camera(model: mujoco.MjModel, given: np.lib.npyio.NpzFile, aspect: float) -> mujoco.MjvCamera:
    """A free camera, so far away that the body is seen whole."""
    half, tall = (float(length) for length in given["extent"])
    camera = mujoco.MjvCamera()
    camera.azimuth = 90.0 + _ASIDE + float(np.degrees(given["heading"]))
    camera.elevation = _DOWN
    camera.lookat[2] = 0.46 * tall
    seen = 2.0 * np.tan(np.radians(0.5 * model.vis.global_.fovy))  # a metre away
    camera.distance = _TIGHT * (max(1.35 * tall, 2.0 * half / aspect) / seen + half * np.sin(np.radians(_ASIDE)))
    return camera


def _paint_limbs(model: mujoco.MjModel, colours: np.ndarray) -> None:
    """Give the bodies that carry one foot alone their limb's colour."""
    above: list[list[int]] = []
    for number in range(1, len(colours) + 1):
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"foot_{number}")
        chain = [int(model.site_bodyid[site])] if site >= 0 else []
        while chain and model.body_parentid[chain[-1]] > 0:
            chain.append(int(model.body_parentid[chain[-1]]))
        above.append(chain)
    carried = np.bincount([body for chain in above for body in chain], minlength=model.nbody)
    for chain, colour in zip(above, colours, strict=True):
        own = [body for body in chain if carried[body] == 1]
        geoms = np.isin(model.geom_bodyid, own)
        model.geom_matid[geoms] = -1
        model.geom_rgba[geoms, :3] = colour


if __name__ == "__main__":
    main()
