"""Compares Jacobians, mass matrices and forces of trees with those of MuJoCo: `scripts/tree-peers`.

tree_peer.py ours FILE OUT makes random states of the file's tree and writes them with our numbers; tree_peer.py mujoco FILE OUT compares
them with MuJoCo's numbers of the same states, and fails if any differs by more than 1e-9 of the largest of its kind.
"""

import sys

import numpy as np

LARGEST = 1e-9
STATES = 50


def ours(file, out):
    """States, and what we say of them."""
    import ambf

    sim = ambf.Simulation(file)
    tree = sim.tree(sim.bodies[-1])
    rng = np.random.default_rng(1)
    n = tree.size
    states = []
    for _ in range(STATES):
        base = rng.normal(size=7)
        base[3:] /= np.linalg.norm(base[3:])
        at = {
            "base_pose": base if tree.is_free else tree.poses()[0],
            "joint_positions": rng.uniform(-1, 1, len(tree.joints)),
        }
        rates, accelerations, point = rng.normal(size=n), rng.normal(size=n), rng.normal(size=3)
        states.append(
            {
                **at,
                "rates": rates,
                "accelerations": accelerations,
                "point": point,
                "mass_matrix": tree.mass_matrix(**at),
                "jacobian": tree.jacobian(len(tree.bodies) - 1, point, **at),
                "bias_forces": tree.bias_forces(rates=rates, **at),
                "forces": tree.inverse_dynamics(accelerations, rates=rates, **at),
            }
        )
    listed = {key: np.array([state[key] for state in states]) for key in states[0]}
    body = tree.bodies[-1].rsplit("/", 1)[-1]
    gravity = sim.gravity if hasattr(sim, "gravity") else (0, 0, -9.8)
    np.savez(out, joints=np.array(tree.joints), body=body, gravity=gravity, is_free=tree.is_free, **listed)


class Worst:
    """The largest differences so far."""

    def __init__(self):
        self.errors = {}

    def see(self, what, ours, theirs):
        error = np.abs(ours - theirs).max() / np.abs(theirs).max()
        self.errors[what] = max(self.errors.get(what, 0.0), error)

    def is_small(self):
        """Prints them."""
        for what, error in self.errors.items():
            print(f"  {what}: largest difference {error:.1e} of the largest number")
        print("  TOO MUCH" if max(self.errors.values()) > LARGEST else "  as it should be")
        return max(self.errors.values()) <= LARGEST


def mujoco(file, out):
    """Compares the numbers with MuJoCo's."""
    import mujoco as mj

    given = np.load(out)
    spec = mj.MjSpec.from_file(file)
    spec.compiler.fusestatic = False
    is_free = bool(given["is_free"])
    if is_free:
        spec.worldbody.first_body().add_freejoint()
    model = spec.compile()
    model.opt.gravity[:] = given["gravity"]
    data = mj.MjData(model)
    joints = [mj.mj_name2id(model, mj.mjtObj.mjOBJ_JOINT, str(name)) for name in given["joints"]]
    body = mj.mj_name2id(model, mj.mjtObj.mjOBJ_BODY, str(given["body"]))
    positions, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    if is_free:
        dofs = np.concatenate([np.arange(6), dofs])
    worst = Worst()
    for state in range(len(given["rates"])):
        rates, accelerations = given["rates"][state], given["accelerations"][state]
        base = given["base_pose"][state]
        if is_free:
            data.qpos[:7] = base[[0, 1, 2, 6, 3, 4, 5]]
        data.qpos[positions] = given["joint_positions"][state]
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_crb(model, data)
        # Their rates of a free base: velocity of its origin in world axes, angular velocity in its own. theirs = change @ ours.
        change, turning = np.eye(model.nv), np.zeros(model.nv)
        if is_free:
            turn = data.xmat[1].reshape(3, 3)
            arm = turn @ model.body_ipos[1]
            change[:3, 3:6] = [[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]]
            change[3:6, 3:6] = turn.T
            turning[:3] = -np.cross(rates[3:6], np.cross(rates[3:6], arm))
        # (nv x n), ours in the order of our joints.
        change = change[:, dofs]
        data.qvel[:] = change @ rates
        # Joints of the file have neither damping nor springs in this comparison: only inertia counts.
        mj.mj_comVel(model, data)
        matrix = np.zeros((model.nv, model.nv))
        mj.mj_fullM(model, data, matrix)
        worst.see("mass_matrix", given["mass_matrix"][state], change.T @ matrix @ change)
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ given["point"][state]
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mj.mj_jac(model, data, linear, angular, point, body)
        worst.see("jacobian", given["jacobian"][state], np.vstack([linear, angular]) @ change)
        for what, wanted in (("bias_forces", np.zeros_like(rates)), ("forces", accelerations)):
            forces = np.zeros(model.nv)
            data.qacc[:] = change @ wanted + turning
            mj.mj_rne(model, data, 1, forces)
            worst.see(what, given[what][state], change.T @ forces)
    print(f"{file}: {len(given['rates'])} states, {len(joints)} joints, MuJoCo {mj.mj_versionString()}")
    return worst.is_small()


if __name__ == "__main__":
    if sys.argv[1] == "ours":
        ours(*sys.argv[2:])
    elif not mujoco(*sys.argv[2:]):
        sys.exit(1)
