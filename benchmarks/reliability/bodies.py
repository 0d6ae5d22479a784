"""MJCFs with one feature each, stepped beside MuJoCo C: how many agree, are refused, or are warned of.

    python -m benchmarks.reliability.bodies                  # the cases, then bodies of installed packages
    python -m benchmarks.reliability.bodies --only sensor    # cases whose names begin so
    python -m benchmarks.reliability.bodies --geometries     # the table of docs/own_model.md

Each is stepped 300 times from its keyframe or start and from 8 random states. A case is `silent` where a
coordinate or a sensor is off by more than 1e-5 (relative where it is above 1), while neither a refusal nor
what is said at first use (a caution, or a difference within 64 steps) names it. `sensitive`: no step differs
by itself, so that the motion only enlarges rounding.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco

import gaitsweep as gs
from gaitsweep.dynamics.mjx.against_c import FIRST_USE, compare
from gaitsweep.dynamics.mjx.refusals import cautions

STEPS = 300
PACKAGES = {
    "dm_control humanoid": ("dm_control", "suite/humanoid.xml"),
    "Gymnasium ant": ("gymnasium", "envs/mujoco/assets/ant.xml"),
    "Gymnasium hopper": ("gymnasium", "envs/mujoco/assets/hopper.xml"),
    "Brax ant": ("brax", "envs/assets/ant.xml"),
    "Barkour": ("mujoco_playground", "external_deps/mujoco_menagerie/google_barkour_vb/scene_mjx.xml"),
}

_OPTION = "<option timestep='0.002'/>"
MESH = (
    "<asset><mesh name='m' vertex='.1 0 0 -.1 0 0 0 .12 0 0 -.08 0 0 0 .1 0 0 -.09'/>"
    "<hfield name='h' nrow='4' ncol='4' size='1 1 .1 .1' elevation='0 0 .2 0 .3 0 1 .4 0 .2 0 .1 .3 0 0 0'/>"
    "</asset>"
)
SHAPES = {
    "sphere": "type='sphere' size='.1'",
    "capsule": "type='capsule' size='.05 .1'",
    "box": "type='box' size='.1 .07 .05'",
    "cylinder": "type='cylinder' size='.06 .1'",
    "ellipsoid": "type='ellipsoid' size='.1 .07 .05'",
    "mesh": "type='mesh' mesh='m'",
}


def thrown(first: str, floor: str = "type='plane' size='5 5 .1'", more: str = "", option: str = "") -> str:
    """A body that is thrown on a floor, or on a body that stands there."""
    return (
        f"<mujoco>{option or _OPTION}{MESH}<worldbody><geom name='floor' {floor}/>"
        "<body name='b' pos='0 0 .3' euler='20 30 10'><freejoint name='f'/>"
        f"<geom name='g' mass='1' {first}/></body></worldbody>{more}"
        "<keyframe><key qpos='0 0 .25 .95 .2 .22 .05' qvel='.5 .2 -1 .3 .2 .1'/></keyframe></mujoco>"
    )


def arm(
    joint: str = "",
    geom: str = "",
    after: str = "",
    option: str = "",
    motor: str = "<motor name='a' joint='j'/>",
    body: str = "",
    world: str = "",
    kind: str = "hinge",
) -> str:
    """Two links in the air, of which the second has a ball joint; the first has the feature."""
    return (
        f"<mujoco>{option or _OPTION}<worldbody><site name='wall' pos='.3 0 1.4'/>"
        f"<camera name='c' pos='0 -2 1'/>{world}"
        f"<body name='one' pos='0 0 1' {body}><joint name='j' type='{kind}' axis='0 1 0' {joint}/>"
        f"<geom name='g' type='capsule' size='.03' fromto='0 0 0 .4 0 0' mass='1' {geom}/>"
        "<site name='s' pos='.3 0 0' euler='10 20 30'/>"
        "<body name='two' pos='.4 0 0'><joint name='k' type='ball' damping='.02'/>"
        "<geom name='g2' type='capsule' size='.03' fromto='0 0 0 .2 .1 0' mass='.5'/>"
        "<site name='tip' pos='.2 0 0'/>"
        f"</body></body></worldbody><actuator>{motor}</actuator>{after}</mujoco>"
    )


def _contacts() -> dict[str, str]:
    results = {}
    for shape, text in SHAPES.items():
        for condim in (1, 3, 4, 6) if shape in ("sphere", "box") else (3,):
            results[f"plane {shape} condim {condim}"] = thrown(f"{text} condim='{condim}'")
        results[f"plane {shape} elliptic"] = thrown(text, option="<option timestep='0.002' cone='elliptic'/>")
    results["plane sphere condim 1 elliptic"] = thrown(
        "size='.1' condim='1'", "type='plane' size='5 5 .1' condim='1'", option="<option cone='elliptic'/>"
    )
    results["plane capsule steep"] = thrown("type='capsule' size='.05 .2' friction='.3' euler='-15 -30 0'")
    results["plane capsule slope"] = thrown(
        SHAPES["capsule"], "type='plane' size='5 5 .1' euler='25 10 0' pos='0 0 -.1'"
    )
    results["plane box slope"] = thrown(
        SHAPES["box"], "type='plane' size='5 5 .1' euler='25 10 0' pos='0 0 -.1'"
    )
    pairs = [
        ("sphere", "sphere"),
        ("sphere", "capsule"),
        ("capsule", "capsule"),
        ("sphere", "box"),
        ("capsule", "box"),
        ("box", "box"),
        ("sphere", "cylinder"),
        ("capsule", "cylinder"),
        ("cylinder", "cylinder"),
        ("sphere", "ellipsoid"),
        ("capsule", "ellipsoid"),
        ("ellipsoid", "ellipsoid"),
        ("ellipsoid", "cylinder"),
        ("cylinder", "box"),
        ("ellipsoid", "box"),
        ("sphere", "mesh"),
        ("box", "mesh"),
        ("mesh", "mesh"),
        ("cylinder", "mesh"),
    ]
    for one, other in pairs:
        results[f"pair {one} {other}"] = thrown(SHAPES[one], SHAPES[other] + " pos='.03 .02 0'")
    for one in ("sphere", "capsule", "box", "mesh", "cylinder"):
        results[f"pair {one} hfield"] = thrown(SHAPES[one], "type='hfield' hfield='h'")
    results["pair parallel capsules"] = (
        thrown("type='capsule' size='.05 .1' euler='0 0 0'", "type='capsule' size='.05 .3' pos='0 0 .1'")
        .replace("euler='20 30 10'", "")
        .replace("qpos='0 0 .25 .95 .2 .22 .05' qvel='.5 .2 -1 .3 .2 .1'", "qpos='0.02 0 .51 1 0 0 0'")
    )
    for name, text in {
        "friction": "friction='.3 .01 .001'",
        "solref": "solref='.01 .7'",
        "solref direct": "solref='-900 -20'",
        "solimp": "solimp='.8 .9 .01 .4 3'",
        "margin": "margin='.02'",
        "gap": "margin='.02' gap='.01'",
        "gap alone": "gap='.02'",
        "priority": "priority='2' friction='.1'",
        "solmix": "solmix='3' solref='.05 1'",
        "adhesion": "adhesion='1'",
        "surfacevel": "surfacevel='1 0 0 0 0 0'",
        "contype": "contype='2'",
    }.items():
        results[f"contact {name}"] = thrown(f"size='.1' {text}")
    for name, text in {
        "pair": "<pair geom1='g' geom2='floor' condim='4' friction='.5 .4 .01 .001 .001' solref='.03 1'/>",
        "pair margin": "<pair geom1='g' geom2='floor' margin='.03'/>",
        "pair solreffriction": "<pair geom1='g' geom2='floor' solreffriction='.05 1'/>",
        "exclude": "<exclude body1='world' body2='b'/>",
    }.items():
        results[f"contact {name}"] = thrown("size='.1'", more=f"<contact>{text}</contact>")
    for name in ("max_contact_points", "max_geom_pairs"):
        number = f"<custom><numeric name='{name}' data='1'/></custom>"
        results[f"contact {name}"] = thrown(SHAPES["box"], more=number)
    return results


def _joints() -> dict[str, str]:
    limited = "range='-20 20' limited='true'"
    results = {
        f"joint {name}": arm(text)
        for name, text in {
            "plain": "",
            "damping": "damping='.3'",
            "stiffness": "stiffness='5'",
            "springref": "stiffness='5' springref='30'",
            "frictionloss": "frictionloss='.2'",
            "armature": "armature='.1'",
            "limited": limited,
            "margin": f"{limited} margin='.1'",
            "both margins": f"{limited} margin='.4'",
            "solreflimit": f"{limited} solreflimit='.05 .8' solimplimit='.8 .9 .1'",
            "ref": f"ref='15' {limited}",
            "actuatorfrcrange": "actuatorfrcrange='-.1 .1'",
            "springdamper": "springdamper='.1 .5'",
            "solreffriction": "frictionloss='.2' solreffriction='.05 1'",
            "damping poly": "damping='.1 .2'",
            "stiffness poly": "stiffness='1 2'",
            "springyield": "stiffness='1' springyield='.1'",
            "actuatorgravcomp": "actuatorgravcomp='true'",
        }.items()
    }
    results["joint slide limited"] = arm("range='-.05 .05' limited='true'", kind="slide")
    results["joint ball limited"] = arm("range='0 25' limited='true'", kind="ball", motor="")
    results["joint gravcomp"] = arm(body="gravcomp='.7'")
    results["joint mocap"] = arm(world="<body name='m' mocap='true' pos='0 0 .9'><geom size='.1'/></body>")
    tendon = "<tendon><spatial name='t' {}><site site='wall'/>{}<site site='tip'/></spatial></tendon>"
    wrap = "<geom name='w' type='{}' size='.08 .1' pos='.3 0 1.1' contype='0' conaffinity='0'/>"
    for name, text in {
        "stiffness": "stiffness='20'",
        "damping": "damping='2'",
        "limited": "range='0 .5' limited='true'",
        "both margins": "range='.4 .6' limited='true' margin='.3'",
        "frictionloss": "frictionloss='1'",
        "armature": "armature='.1'",
        "deadband": "stiffness='20' springlength='.2 .4'",
    }.items():
        results[f"tendon {name}"] = arm(after=tendon.format(text, ""))
    for shape in ("sphere", "cylinder"):
        text = tendon.format("stiffness='20'", "<geom geom='w'/>")
        results[f"tendon wrap {shape}"] = arm(after=text, world=wrap.format(shape))
    results["tendon pulley"] = arm(
        after="<tendon><spatial name='t' stiffness='20'><site site='wall'/><site site='s'/>"
        "<pulley divisor='2'/><site site='s'/><site site='wall'/></spatial></tendon>"
    )
    results["tendon fixed"] = arm(
        after="<tendon><fixed name='t' stiffness='3'><joint joint='j' coef='2'/></fixed></tendon>"
    )
    slider = "<body pos='1 0 1'><joint name='x' axis='0 1 0'/><geom size='.1' pos='.1 0 0' mass='1'/></body>"
    for name, text in {
        "joint": "<joint joint1='j' joint2='x' polycoef='0 .5 .2 0 0'/>",
        "connect": "<connect name='e' body1='two' anchor='0 0 0'/>",
        "weld": "<weld name='e' body1='two'/>",
        "inactive": "<joint joint1='j' joint2='x' active='false'/>",
    }.items():
        results[f"equality {name}"] = arm(after=f"<equality>{text}</equality>", world=slider)
    return results


def _actuators() -> dict[str, str]:
    tendon = "<tendon><fixed name='t'><joint joint='j' coef='2'/></fixed></tendon>"
    texts = {
        "position": "<position joint='j' kp='5' kv='.3'/>",
        "velocity": "<velocity joint='j' kv='2'/>",
        "intvelocity": "<intvelocity joint='j' kp='5' actrange='-2 2'/>",
        "damper": "<damper joint='j' kv='1' ctrlrange='0 1'/>",
        "muscle": "<muscle joint='j' lengthrange='-1 1'/>",
        "cylinder": "<cylinder joint='j' timeconst='.1' area='2'/>",
        "filter": "<general joint='j' dyntype='filter' dynprm='.1' gainprm='2'/>",
        "filterexact": "<general joint='j' dyntype='filterexact' dynprm='.1' gainprm='2'/>",
        "integrator": "<general joint='j' dyntype='integrator' gainprm='2' actrange='-.1 .1'/>",
        "actearly": "<general joint='j' dyntype='filter' dynprm='.1' actearly='true'/>",
        "ctrlrange": "<motor joint='j' ctrllimited='true' ctrlrange='-.1 .1'/>",
        "forcerange": "<motor joint='j' forcelimited='true' forcerange='-.1 .1'/>",
        "gear": "<motor joint='j' gear='3'/>",
        "affine gain": "<general joint='j' gaintype='affine' gainprm='1 .5 .2'/>",
        "ball": "<motor joint='k' gear='1 .5 .2'/>",
        "jointinparent": "<motor jointinparent='k' gear='1 .5 .2'/>",
        "site": "<motor site='tip' gear='1 2 0 0 .3 0'/>",
        "refsite": "<position site='tip' refsite='s' kp='3' gear='1 0 0 0 0 0'/>",
        "tendon": "<motor tendon='t'/>",
        "slidercrank": "<motor cranksite='tip' slidersite='wall' cranklength='1'/>",
        "adhesion": "<adhesion body='one' ctrlrange='0 1'/>",
        "delay": "<motor joint='j' delay='.02' nsample='12'/>",
        "armature": "<motor joint='j' armature='.1'/>",
        "damping": "<motor joint='j' damping='.1'/>",
        "dcmotor": "<dcmotor joint='j' motorconst='.1' resistance='1'/>",
        "group disabled": "<motor joint='j' group='2'/>",
    }
    results = {f"actuator {name}": arm(motor=text, after=tendon) for name, text in texts.items()}
    disabled = "<option timestep='0.002' actuatorgroupdisable='2'/>"
    results["actuator group disabled"] = arm(motor=texts["group disabled"], option=disabled)
    results["actuator none"] = arm(motor="")
    return results


def _sensors() -> dict[str, str]:
    sites = "<site site='wall'/><site site='tip'/>"
    tendon = f"<tendon><spatial name='t' range='0 .5' limited='true'>{sites}</spatial></tendon>"
    site, joint, frame = "site='tip'", "joint='j'", "objtype='body' objname='two'"
    within = "reftype='site' refname='s'"
    texts = {
        **dict.fromkeys(("accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer"), site),
        **dict.fromkeys(("jointpos", "jointvel", "jointactuatorfrc"), joint),
        **dict.fromkeys(("jointlimitpos", "jointlimitvel", "jointlimitfrc"), joint),
        **dict.fromkeys(("tendonpos", "tendonvel", "tendonlimitpos", "tendonlimitfrc"), "tendon='t'"),
        **dict.fromkeys(("actuatorpos", "actuatorvel", "actuatorfrc"), "actuator='a'"),
        **dict.fromkeys(("ballquat", "ballangvel"), "joint='k'"),
        **dict.fromkeys(("framepos", "framequat", "framexaxis"), f"{frame} {within}"),
        **dict.fromkeys(("framelinvel", "frameangvel"), f"{frame} {within}"),
        **dict.fromkeys(("framelinacc", "frameangacc"), frame),
        **dict.fromkeys(("subtreecom", "subtreelinvel", "subtreeangmom"), "body='one'"),
        **dict.fromkeys(("clock", "e_potential", "e_kinetic"), ""),
        "camprojection": "site='tip' camera='c'",
        "rangefinder": "site='tip'",
        "distance": "geom1='g' geom2='g2'",
        "insidesite": "objtype='body' objname='two' site='wall'",
    }
    limited = "range='-20 20' limited='true'"
    results = {
        f"sensor {kind}": arm(
            limited if "limit" in kind else "",
            after=f"{tendon if 'tendon' in kind else ''}<sensor><{kind} name='x' {text}/></sensor>",
        )
        for kind, text in texts.items()
    }
    results["sensor force of a tendon"] = arm(after=f"{tendon}<sensor><force name='x' site='tip'/></sensor>")
    for kind, text in {
        "accelerometer": site,
        "framelinacc": frame,
        "jointvel": joint,
        "framepos": frame,
    }.items():
        results[f"sensor cutoff {kind}"] = arm(
            after=f"<sensor><{kind} name='x' {text} cutoff='.3'/></sensor>"
        )
    for name, text in {
        "delay": "nsample='10' delay='.01'",
        "interval": "interval='.02'",
        "noise": "noise='.1'",
    }.items():
        results[f"sensor {name}"] = arm(after=f"<sensor><jointvel name='x' joint='j' {text}/></sensor>")
    for kind in ("jointpos", "actuatorfrc", "clock"):
        text = f"<sensor><{kind} name='x' {texts[kind]}/></sensor>"
        results[f"sensor RK4 {kind}"] = arm(after=text, option="<option timestep='0.005' integrator='RK4'/>")
    on = "<site name='pad' type='sphere' size='.12'/>"
    touch = thrown("size='.1'", more="<sensor><touch name='x' site='pad'/></sensor>")
    results["sensor touch"] = touch.replace("</body></worldbody>", f"{on}</body></worldbody>")
    for name, text in {
        "geoms": "geom1='g' geom2='floor' data='found force dist pos'",
        "bodies": "body1='b' data='force'",
        "all": "num='2' data='found force'",
        "net": "geom1='g' reduce='netforce' data='force'",
    }.items():
        results[f"sensor contact {name}"] = thrown(
            "size='.1'", more=f"<sensor><contact name='x' {text}/></sensor>"
        )
    ranging = thrown("size='.1'", more="<sensor><rangefinder name='x' site='pad'/></sensor>")
    results["sensor rangefinder plane"] = ranging.replace("</body></worldbody>", f"{on}</body></worldbody>")
    return results


def _options() -> dict[str, str]:
    results = {}
    for name in ("Euler", "RK4", "implicit", "implicitfast"):
        results[f"option {name}"] = arm(
            "damping='.3'", option=f"<option timestep='0.005' integrator='{name}'/>"
        )
    for name, text in {
        "CG": "solver='CG'",
        "PGS": "solver='PGS'",
        "impratio": "impratio='5' cone='elliptic'",
        "sparse": "jacobian='sparse'",
        "wind": "wind='1 0 0' density='50'",
        "viscosity": "viscosity='.1'",
        "noslip": "noslip_iterations='3'",
        "iterations": "iterations='2'",
        "tolerance": "tolerance='1e-4'",
        "RK4": "integrator='RK4'",
        "implicitfast": "integrator='implicitfast'",
    }.items():
        results[f"thrown option {name}"] = thrown(SHAPES["box"], option=f"<option timestep='0.002' {text}/>")
    results["option fluidshape"] = thrown("size='.1' fluidshape='ellipsoid'", option="<option density='50'/>")
    for flag in (
        "constraint",
        "limit",
        "spring",
        "gravity",
        "clampctrl",
        "warmstart",
        "filterparent",
        "actuation",
        "refsafe",
        "sensor",
        "eulerdamp",
    ):
        option = f"<option timestep='0.002'><flag {flag}='disable'/></option>"
        results[f"flag no {flag}"] = arm(
            "damping='.3' stiffness='1' range='-20 20' limited='true'",
            motor="<motor name='a' joint='j' ctrlrange='-.1 .1'/>",
            after="<sensor><jointpos joint='j'/></sensor>",
            option=option,
        )
    for flag in ("override", "energy", "fwdinv", "invdiscrete", "sleep"):
        option = f"<option timestep='0.002'><flag {flag}='enable'/></option>"
        results[f"flag {flag}"] = thrown("size='.1'", option=option)
    filtered = "<general joint='j' dyntype='filter' dynprm='.3' gainprm='3'/>"
    for name, text in {
        "act": "act='2'",
        "ctrl": "ctrl='1'",
        "time": "time='3'",
        "qvel": "qvel='1 0 0 0'",
        "mpos": "mpos='.1 0 .8' mquat='.7 .7 0 0'",
    }.items():
        mocap = "<body mocap='true' pos='0 0 .5'><geom type='capsule' size='.05 .2'/></body>"
        sensor = "<sensor><clock/><framepos objtype='body' objname='two'/></sensor>"
        results[f"keyframe {name}"] = arm(
            motor=filtered, world=mocap, after=f"{sensor}<keyframe><key name='home' {text}/></keyframe>"
        )
    return results


def model_of(xml: str) -> gs.MjcfModel:
    """A model of an MJCF, whose actuators follow sines."""
    source = mujoco.MjModel  # pyright: ignore[reportAttributeAccessIssue] (a compiled module without a stub)
    compiled = source.from_xml_string if xml.lstrip().startswith("<") else source.from_xml_path
    number = compiled(xml).nu
    members = {
        "body_file": xml,
        "omega": gs.parameter("rad/s", "frequency", 9.0),
        "phi": gs.variable("rad", "phase", 0.0),
        "control": lambda self, p, s: 0.5 * jnp.sin(s.phi + jnp.arange(number)),
        "rates": lambda self, p, s: {"phi": p.omega},
        "period": lambda self, p: 2.0 * jnp.pi / p.omega,
    }
    return type("Body", (gs.MjcfModel,), members)(dynamics="mjx")


def judged(xml: str) -> tuple[str, str]:
    """The verdict on an MJCF, and the sentence or the number for it."""
    try:
        model = model_of(xml)
    except ValueError as error:
        return "not MuJoCo's", str(error)
    try:
        model.mjx_body  # noqa: B018 - compiles it
        result = compare(model, STEPS)
    except ValueError as error:
        return "refused", str(error)
    message = cautions(model.mjx_body.mj_model)
    early = [str(cause) for cause in result.caused if cause.step <= FIRST_USE]
    if result.caused:
        verdict = "warned" if message or early else "silent"
        return verdict, (message + early + [str(cause) for cause in result.caused])[0]
    return ("sensitive" if result.divergences else "agrees"), f"{result.largest:.1e}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose names begin so")
    parser.add_argument("--geometries", action="store_true", help="contacts of shapes alone")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    cases = {**_sensors(), **_options(), **_joints(), **_contacts(), **_actuators()}
    if options.geometries:
        cases = {name: xml for name, xml in cases.items() if name.startswith(("plane", "pair"))}
    counts: Counter[str] = Counter()
    for name, xml in cases.items():
        if name.startswith(options.only):
            began = time.perf_counter()
            verdict, why = judged(xml)
            counts[verdict] += 1
            print(f"{verdict:10} {name:32} {time.perf_counter() - began:5.1f} s  {why}", flush=True)
            jax.clear_caches()
    for name, (package, file) in PACKAGES.items():
        if not options.only or name.startswith(options.only):
            spec = importlib.util.find_spec(package)
            path = None if spec is None or spec.origin is None else Path(spec.origin).parent / file
            if path is None or not path.is_file():
                print(f"{'skipped':10} {name:32} {package} is not installed, or has no {file}", flush=True)
                continue
            verdict, why = judged(str(path))
            print(f"{verdict:10} {name:32} {why}", flush=True)
            counts[verdict] += verdict == "silent"
    print(f"{sum(counts.values())} MJCFs: " + ", ".join(f"{n} {verdict}" for verdict, n in counts.items()))
    return 1 if counts["silent"] else 0


if __name__ == "__main__":
    sys.exit(main())
