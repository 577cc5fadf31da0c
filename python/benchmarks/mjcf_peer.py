"""Compares MJCF files as they are read here with MuJoCo's own reading: `scripts/mjcf-peers`.

mjcf_peer.py ours FILE OUT makes random states of the trees of a file and lets all fall freely; mjcf_peer.py mujoco FILE OUT does the same
with MuJoCo and fails where mass matrix, gravity forces or the fall differ by more than 1e-6.
"""

import pathlib
import re
import sys
import tempfile

import numpy as np

LARGEST = 1e-6
STATES = 10
# Of the fall, s. Strong dampers make both sides first-order in their steps: two steps each, and Richardson's extrapolation to none.
SECONDS = 0.1
OUR_STEPS, MUJOCO_STEPS = (5e-6, 2.5e-6), (5e-5, 2.5e-5)
WRAPPER = """<mujoco><include file="{name}"/><option>
<flag contact="disable" limit="disable" equality="disable" frictionloss="disable" actuation="disable"/></option></mujoco>"""
WORLD = "environment: ~\nphysics: {{sub step: {step}}}\n"


def simulation(file, step):
    """The file with us, without contacts and limits, in sub-steps of `step` s."""
    import ambf

    file = pathlib.Path(file)
    wrapper = file.with_name(f"{file.stem}_free_fall.xml")
    wrapper.write_text(WRAPPER.format(name=file.name))
    try:
        with tempfile.NamedTemporaryFile("w", suffix=".yaml") as world:
            world.write(WORLD.format(step=step))
            world.flush()
            return ambf.Simulation(wrapper, world=world.name, profile="accurate", step=step)
    finally:
        wrapper.unlink()


def limit(ends):
    """What the ends of a motion in steps and in half of them tend to."""
    coarse, fine = ends
    return 2 * fine - coarse


def our_end(file, step):
    """Positions and quaternions w, x, y, z of all bodies after the fall."""
    sim = simulation(file, step)
    sim.step(round(SECONDS / step))
    return sim.poses[:, [0, 1, 2, 6, 3, 4, 5]]


def ours(file, out):
    """States, and what we say of them."""
    import ambf

    sim = simulation(file, OUR_STEPS[0])
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
    np.savez(
        out,
        states=len(states),
        names=np.array([last(name) for name in sim.bodies], dtype=str),
        ends=np.array([our_end(file, step) for step in OUR_STEPS]),
        others=np.array(others, dtype=str),
        **numbers,
    )


def last(name):
    """The name in the file: without the namespace."""
    return re.sub(r"^.*/env/[^/]*/", "", name)


def plain(name):
    """A name as bodies have it with us, who name topics after them."""
    return re.sub(r"\W", "_", re.sub(r"\s", "", name), flags=re.ASCII)


def body_id(model, name):
    """MuJoCo's number of a body of ours: the one in the name where the file gives none; -1 of what is a body only with us."""
    names = [plain(model.body(body).name) for body in range(model.nbody)]
    if name in names:
        return names.index(name)
    unnamed = re.fullmatch(r"body(\d+)_*", name)
    return int(unnamed[1]) if unnamed and int(unnamed[1]) < model.nbody and not names[int(unnamed[1])] else -1


def joint_id(model, name):
    """MuJoCo's number of a joint of ours: without a name it is called after its body and the joints before it there."""
    names = [re.sub(r"\s", "", model.joint(joint).name) for joint in range(model.njnt)]
    if name in names:
        return names.index(name)
    body, number = re.fullmatch(r"(.*)_joint(\d+)_*", name).groups()
    return model.body_jntadr[body_id(model, plain(body))] + int(number)


def their_model(mj, file):
    """The file with MuJoCo, without contacts, limits and air."""
    model = mj.MjModel.from_xml_path(file)
    flags = ("CONTACT", "LIMIT", "EQUALITY", "FRICTIONLOSS", "ACTUATION", "AUTORESET")
    for flag in flags:
        model.opt.disableflags |= getattr(mj.mjtDisableBit, f"mjDSBL_{flag}")
    # Explicit methods diverge where a light part has a strong damper.
    model.opt.integrator = mj.mjtIntegrator.mjINT_IMPLICIT
    model.opt.density, model.opt.viscosity, model.opt.wind = 0, 0, 0
    return model


def their_end(mj, model, step):
    """As `our_end`, with MuJoCo's implicit method."""
    data = mj.MjData(model)
    model.opt.timestep = step
    for _ in range(round(SECONDS / step)):
        mj.mj_step(model, data)
    mj.mj_kinematics(model, data)
    return np.hstack([data.xpos, data.xquat])


def fallen(mj, model, given):
    """How far bodies fall from where they fall with us, m, or quaternions' numbers from each other; and how many these are."""
    ends = [given["ends"], np.array([their_end(mj, model, step) for step in MUJOCO_STEPS])]
    for end in ends:
        # Of both quaternions of an orientation that near the first one's start.
        turned = np.sum(end[..., 3:] * end[:1, ..., 3:], axis=-1, keepdims=True) < 0
        end[..., 3:] = np.where(turned, -1, 1) * end[..., 3:]
    mine, theirs = map(limit, ends)
    bodies = np.array([body_id(model, str(name)) for name in given["names"]], dtype=int)
    mine, theirs = mine[bodies > 0], theirs[bodies[bodies > 0]]
    mine[:, 3:] *= np.sign(np.sum(mine[:, 3:] * theirs[:, 3:], axis=1, keepdims=True))
    return np.abs(mine - theirs).max(initial=0.0), len(set(bodies[bodies > 0]))


def mujoco(file, out):
    """Compares the numbers with MuJoCo's."""
    import mujoco as mj

    given = np.load(out)
    model = their_model(mj, file)
    data = mj.MjData(model)
    errors = {"mass matrix": 0.0, "gravity forces": 0.0}
    # Moments about upright axes are rounding errors: those below that of the weight of all at a nanometre.
    upright = 1e-9 * model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity)
    for state in range(int(given["states"])):
        of = lambda key, state=state: given[f"{key}/{state}"]  # noqa: E731
        names = [str(name) for name in of("joints")]
        joints = [joint_id(model, last(name)) for name in names]
        mj.mj_resetData(model, data)
        data.qpos[model.jnt_qposadr[joints]] = of("joint_positions")
        dofs = model.jnt_dofadr[joints]
        change = np.eye(model.nv)
        if str(of("body")):
            body = body_id(model, str(of("body")))
            free = model.body_jntadr[body]
            place, dof = model.jnt_qposadr[free], model.jnt_dofadr[free]
            data.qpos[place : place + 7] = of("base_pose")[[0, 1, 2, 6, 3, 4, 5]]
            dofs = np.concatenate([np.arange(dof, dof + 6), dofs])
        mj.mj_forward(model, data)
        if str(of("body")):
            turn = data.xmat[body].reshape(3, 3)
            # What has no mass of its own has its centre of mass at its frame with us.
            arm = turn @ model.body_ipos[body] * (model.body_mass[body] > 0)
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
        for what, mine, theirs, least in (
            ("mass matrix", of("mass_matrix"), change.T @ matrix @ change, 0.0),
            ("gravity forces", of("gravity_forces"), change.T @ (forces - data.qfrc_gravcomp), upright),
        ):
            if theirs.size:
                error = np.abs(mine - theirs).max() / max(np.abs(theirs).max(), least, 1e-12)
                errors[what] = np.maximum(errors[what], error)
    errors["fall"], bodies = fallen(mj, model, given)
    text = ", ".join(f"{what} {error:.1e}" for what, error in errors.items())
    # What is no number is not small.
    is_small = all(error <= LARGEST for error in errors.values()) and bodies == model.nbody - 1
    counts = f"{model.nv} rates, {bodies} of {model.nbody - 1} bodies"
    print(f"{'as it should be' if is_small else 'TOO MUCH':16} {pathlib.Path(file).name}: {counts}: {text}")
    for other in given["others"]:
        print(f"    no tree: {other}")
    return is_small


if __name__ == "__main__":
    if sys.argv[1] == "ours":
        ours(*sys.argv[2:])
    elif not mujoco(*sys.argv[2:]):
        sys.exit(1)
