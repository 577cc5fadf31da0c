"""Compares MJCF files as they are read here with MuJoCo's own reading: `scripts/mjcf-peers`.

mjcf_peer.py ours FILE OUT makes random states of the trees of a file and lets all fall freely; mjcf_peer.py mujoco FILE OUT does the same
with MuJoCo and fails where mass matrix, gravity forces or the fall differ by more than 1e-6.
"""

import pathlib
import re
import sys

import numpy as np

LARGEST = 1e-6
STATES = 10
SECONDS, SUB_STEP = 0.1, 1e-4
WRAPPER = """<mujoco><include file="{name}"/><option timestep="{step}" integrator="RK4">
<flag contact="disable" limit="disable" equality="disable" frictionloss="disable" actuation="disable"/></option></mujoco>"""


def wrapped(file):
    """A file beside another one that includes it without contacts and limits."""
    file = pathlib.Path(file)
    wrapper = file.with_name(f"{file.stem}_free_fall.xml")
    wrapper.write_text(WRAPPER.format(name=file.name, step=SUB_STEP))
    return wrapper


def ours(file, out):
    """States, and what we say of them."""
    import ambf

    wrapper = wrapped(file)
    try:
        sim = ambf.Simulation(wrapper, profile="accurate", step=SUB_STEP)
    finally:
        wrapper.unlink()
    rng = np.random.default_rng(1)
    trees, seen, others = [], set(), []
    for body in range(len(sim.bodies)):
        if sim.bodies[body] in seen or sim.masses[body] == 0:
            continue
        try:
            tree = sim.tree(body)
        except ambf.TreeError as error:
            others.append(str(error))
            continue
        seen.update(tree.bodies)
        trees.append(tree)
    states = []
    for tree in trees:
        base = np.zeros(7)
        for _ in range(STATES):
            base[:3], base[3:] = rng.normal(size=3), rng.normal(size=4)
            base[3:] /= np.linalg.norm(base[3:])
            pose = base.copy() if tree.is_free else tree.poses()[0]
            at = {"base_pose": pose, "joint_positions": rng.uniform(-1, 1, len(tree.joints))}
            states.append(
                {
                    "joints": np.array(tree.joints, dtype=str),
                    "body": last(tree.bodies[0]) if tree.is_free else "",
                    "mass_matrix": tree.mass_matrix(**at),
                    "gravity_forces": tree.gravity_forces(**at),
                    **at,
                }
            )
    numbers = {f"{key}/{index}": value for index, state in enumerate(states) for key, value in state.items()}
    start = sim.joint_positions.copy()
    sim.step(round(SECONDS / SUB_STEP))
    np.savez(
        out,
        states=len(states),
        names=np.array([last(name) for name in sim.bodies], dtype=str),
        poses=sim.poses,
        joint_names=np.array(sim.joints, dtype=str),
        moved=sim.joint_positions - start,
        time=sim.sim_time,
        others=np.array(others, dtype=str),
        **numbers,
    )


def last(name):
    """The name in the file: without the namespace."""
    return re.sub(r"^.*/env/[^/]*/", "", name)


def fallen(mj, model, data, given):
    """How far bodies that fall with MuJoCo are from where they fall with us, m, and their orientations, 1 - |cosine of half the angle|."""
    mj.mj_resetData(model, data)
    for _ in range(round(float(given["time"]) / SUB_STEP)):
        mj.mj_step(model, data)
    mj.mj_kinematics(model, data)
    fall = 0.0
    for name, pose in zip(given["names"], given["poses"]):
        body = mj.mj_name2id(model, mj.mjtObj.mjOBJ_BODY, str(name))
        if body > 0:
            fall = max(fall, np.abs(data.xpos[body] - pose[:3]).max())
            fall = max(fall, np.abs(np.abs(data.xquat[body] @ pose[[6, 3, 4, 5]]) - 1))
    return fall


def mujoco(file, out):
    """Compares the numbers with MuJoCo's."""
    import mujoco as mj

    given = np.load(out)
    wrapper = wrapped(file)
    try:
        model = mj.MjModel.from_xml_path(str(wrapper))
    finally:
        wrapper.unlink()
    data = mj.MjData(model)
    errors = {"mass matrix": 0.0, "gravity forces": 0.0}
    for state in range(int(given["states"])):
        of = lambda key, state=state: given[f"{key}/{state}"]  # noqa: E731
        names = [str(name) for name in of("joints")]
        joints = [mj.mj_name2id(model, mj.mjtObj.mjOBJ_JOINT, last(name)) for name in names]
        mj.mj_resetData(model, data)
        data.qpos[model.jnt_qposadr[joints]] = of("joint_positions")
        dofs = model.jnt_dofadr[joints]
        change = np.eye(model.nv)
        if str(of("body")):
            body = mj.mj_name2id(model, mj.mjtObj.mjOBJ_BODY, str(of("body")))
            free = model.body_jntadr[body]
            place, dof = model.jnt_qposadr[free], model.jnt_dofadr[free]
            data.qpos[place : place + 7] = of("base_pose")[[0, 1, 2, 6, 3, 4, 5]]
            dofs = np.concatenate([np.arange(dof, dof + 6), dofs])
        mj.mj_forward(model, data)
        if str(of("body")):
            turn = data.xmat[body].reshape(3, 3)
            arm = turn @ model.body_ipos[body]
            change[dof : dof + 3, dof + 3 : dof + 6] = [
                [0, -arm[2], arm[1]],
                [arm[2], 0, -arm[0]],
                [-arm[1], arm[0], 0],
            ]
            change[dof + 3 : dof + 6, dof + 3 : dof + 6] = turn.T
        change = change[:, dofs]
        matrix, forces = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        mj.mj_fullM(model, data, matrix)
        data.qvel[:], data.qacc[:] = 0, 0
        mj.mj_rne(model, data, 0, forces)
        for what, mine, theirs in (
            ("mass matrix", of("mass_matrix"), change.T @ matrix @ change),
            ("gravity forces", of("gravity_forces"), change.T @ (forces - data.qfrc_gravcomp)),
        ):
            if theirs.size:
                error = np.abs(mine - theirs).max() / max(np.abs(theirs).max(), 1e-12)
                errors[what] = max(errors[what], error)
    errors["fall"] = fallen(mj, model, data, given)
    bodies = len({str(name) for name in given["names"]})
    text = ", ".join(f"{what} {error:.1e}" for what, error in errors.items())
    is_small = max(errors.values()) <= LARGEST
    print(
        f"{'as it should be' if is_small else 'TOO MUCH':16} {pathlib.Path(file).name}: {model.nv} rates, {bodies} bodies: {text}"
    )
    for other in given["others"]:
        print(f"    no tree: {other}")
    return is_small


if __name__ == "__main__":
    if sys.argv[1] == "ours":
        ours(*sys.argv[2:])
    elif not mujoco(*sys.argv[2:]):
        sys.exit(1)
