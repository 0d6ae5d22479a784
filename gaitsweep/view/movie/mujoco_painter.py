"""The program that renders a body with MuJoCo and OpenGL, for `mujoco_movie`.

It reads an .npz from standard input and writes the bytes of an RGB frame for each sample to standard output.
It is a separate process because MuJoCo chooses its OpenGL once, when it is imported, and because a crash of
the driver then ends only this process.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import io
import os
import sys

import mujoco
import numpy as np
from jaxtyping import Float

_SQUARES = "gaitsweep/squares"  # texture and material of the ground, beside those of the file
_ASIDE = 28.0  # degrees: azimuth of the camera ahead of the right side
_DOWN = -14.0  # degrees: elevation of the camera
_VIEW = 25.0  # degrees: vertical field of view
_MARGIN = 1.08  # factor on the distance at which the body just fits
_SHADOW = 1024  # pixels: with software OpenGL, MuJoCo's 4096 take most of the time


def main() -> None:
    """Render the frames described on standard input, and write their pixels to standard output."""
    request = np.load(io.BytesIO(sys.stdin.buffer.read()))
    pictures = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of libraries must not mix with the frames
    model = _staged(str(request["mjcf"]), float(request["square"]))
    data = mujoco.MjData(model)
    width, height = (int(pixels) for pixels in request["size"])
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.global_.fovy = _VIEW
    model.vis.quality.shadowsize = _SHADOW
    _light(model)
    _paint_limbs(model, request["colours"])
    camera = _camera(request, width / height)
    above = camera.lookat.copy()  # the ground below the body
    shown = _shown()
    renderer = mujoco.Renderer(model, height, width)
    of_world = model.light_bodyid == 0
    lamps = model.light_pos[of_world]
    for qpos, middle in zip(request["qpos"], request["middle"], strict=True):
        data.qpos = qpos
        model.light_pos[of_world] = lamps + middle  # a lamp casts shadows only near itself
        mujoco.mj_forward(model, data)
        camera.lookat[:] = middle + above
        renderer.update_scene(data, camera, shown)
        pictures.write(renderer.render().tobytes())
        pictures.flush()
    renderer.close()


def _staged(mjcf: str, square: float) -> mujoco.MjModel:
    """The model, with a white sky and a ground of squares (m) where it has none.

    Without a sky it would be black; on ground of one colour a body seems to step on the spot.
    """
    spec = mujoco.MjSpec.from_string(mjcf)
    skybox = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    if not any(texture.type == skybox for texture in spec.textures):
        look = {"builtin": mujoco.mjtBuiltin.mjBUILTIN_FLAT, "width": 8, "height": 8}
        spec.add_texture(type=skybox, rgb1=[1.0] * 3, rgb2=[1.0] * 3, **look)
    flat = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    plain = [geom for geom in spec.worldbody.geoms if geom.type in flat and not geom.material]
    if plain:
        spec.add_texture(
            name=_SQUARES, type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            width=256, height=256, rgb1=[0.93, 0.93, 0.91], rgb2=[0.82, 0.82, 0.8],
        )  # fmt: skip
        material = spec.add_material(name=_SQUARES, texuniform=True, texrepeat=[0.5 / square] * 2)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = _SQUARES
        for geom in plain:
            geom.material = _SQUARES
    return spec.compile()


def _shown() -> mujoco.MjvOption:
    """The options of MuJoCo's viewer, without sites: zones of sensors look like feet, and hide the feet."""
    shown = mujoco.MjvOption()
    shown.sitegroup[:] = 0
    return shown


def _camera(request: np.lib.npyio.NpzFile, aspect: float) -> mujoco.MjvCamera:
    """A free camera, far enough away that the whole body is visible."""
    half, tall = (float(length) for length in request["extent"])
    camera = mujoco.MjvCamera()
    camera.azimuth = 90.0 + _ASIDE + float(np.degrees(request["heading"]))
    camera.elevation = _DOWN
    camera.lookat[2] = 0.46 * tall
    height_at_a_metre = 2.0 * np.tan(np.radians(0.5 * _VIEW))
    to_fit = max(1.2 * tall, 2.0 * half / aspect) / height_at_a_metre
    camera.distance = _MARGIN * (to_fit + half * np.sin(np.radians(_ASIDE)))
    return camera


def _light(model: mujoco.MjModel) -> None:
    """Set light in which marks and shadows on pale ground are visible; more from the viewer without lamps."""
    headlight = 1.0 if model.nlight else 1.4
    model.vis.headlight.ambient[:] = 0.42 * headlight
    model.vis.headlight.diffuse[:] = 0.4 * headlight
    model.vis.headlight.specular[:] = 0.0
    model.light_diffuse[:] = 0.3
    model.light_specular[:] = 0.0


def _paint_limbs(model: mujoco.MjModel, colours: Float[np.ndarray, "limbs channels"]) -> None:
    """Give the bodies that carry exactly one foot the colour of their limb."""
    chains: list[list[int]] = []  # the bodies between each foot and the world
    for number in range(1, len(colours) + 1):
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"foot_{number}")
        chain = [int(model.site_bodyid[site])] if site >= 0 else []
        while chain and model.body_parentid[chain[-1]] > 0:
            chain.append(int(model.body_parentid[chain[-1]]))
        chains.append(chain)
    feet_of_body = np.bincount([body for chain in chains for body in chain], minlength=model.nbody)
    for chain, colour in zip(chains, colours, strict=True):
        of_limb = [body for body in chain if feet_of_body[body] == 1]
        geoms = np.isin(model.geom_bodyid, of_limb)
        model.geom_matid[geoms] = -1
        model.geom_rgba[geoms, :3] = colour


if __name__ == "__main__":
    main()
