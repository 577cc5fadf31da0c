"""Rotations and transforms: conventions are those of tf.transformations."""

import itertools
import math
import unittest

import numpy as np
from ambf_client import rotations
from ambf_client import transformations as tf

HALF = math.sqrt(0.5)
X, Y, Z = np.eye(3)
ORDERS = [
    frame + "".join(axes) for frame in "sr" for axes in itertools.product("xyz", repeat=3) if axes[1] not in axes[::2]
]


class Transformations(unittest.TestCase):
    """Against each other, and against turns about single axes."""

    def same(self, found, expected, **tolerance):
        np.testing.assert_allclose(found, expected, atol=1e-9, **tolerance)

    def test_quaternions(self):
        """x, y, z, w; the product turns by the second, then by the first."""
        self.same(tf.quaternion_about_axis(math.pi / 2, [0, 0, 2]), [0, 0, HALF, HALF])
        a, b = tf.quaternion_about_axis(0.4, X), tf.quaternion_about_axis(-0.7, Y)
        self.same(tf.quaternion_matrix(tf.quaternion_multiply(a, b)), tf.quaternion_matrix(a) @ tf.quaternion_matrix(b))
        self.same(tf.quaternion_multiply(a, tf.quaternion_inverse(2 * a)), [0, 0, 0, 0.5])
        self.same(tf.quaternion_conjugate(a), tf.quaternion_about_axis(-0.4, X))
        self.same(tf.quaternion_matrix([0, 0, 0, 0]), np.eye(4))
        self.same(tf.quaternion_slerp(a, -tf.quaternion_about_axis(0.8, X), 0.25), tf.quaternion_about_axis(0.5, X))
        self.same(tf.quaternion_slerp(a, a, 0.25), a)

    def test_the_default_order(self):
        """As in the client's own functions, and as `get_rpy` of a handle."""
        self.same(tf.quaternion_from_euler(0.1, 0.2, 0.3), rotations.quaternion_from_rpy(0.1, 0.2, 0.3))
        self.same(tf.quaternion_from_euler(0.1, 0.2, 0.3, "szyx"), rotations.quaternion_from_zyx(0.1, 0.2, 0.3))
        self.same(tf.euler_from_quaternion(tf.quaternion_from_euler(0.1, 0.2, 0.3)), (0.1, 0.2, 0.3))
        turns = [tf.rotation_matrix(angle, axis) for angle, axis in ((0.1, X), (0.2, Y), (0.3, Z))]
        self.same(tf.euler_matrix(0.1, 0.2, 0.3), turns[2] @ turns[1] @ turns[0])
        self.same(tf.euler_matrix(0.1, 0.2, 0.3, "rxyz"), turns[0] @ turns[1] @ turns[2])

    def test_all_orders(self):
        """Angles come back where they are defined; elsewhere the rotation does."""
        self.assertEqual(len(ORDERS), 24)
        rng = np.random.default_rng(1)
        for axes in ORDERS:
            # Of axes of which the first is also the last, the middle angle has one sign.
            bounds = (-1.5, 1.5)
            if axes[1] == axes[3]:
                right_handed = ("xyz".index(axes[2]) - "xyz".index(axes[1])) % 3 == 1
                bounds = (0.1, 3.0) if right_handed else (-3.0, -0.1)
            for _ in range(20):
                angles = (rng.uniform(-3, 3), rng.uniform(*bounds), rng.uniform(-3, 3))
                matrix = tf.euler_matrix(*angles, axes)
                self.same(tf.euler_from_matrix(matrix, axes), angles)
                quaternion = tf.quaternion_from_matrix(matrix)
                self.same(tf.quaternion_matrix(quaternion), matrix)
                self.same(tf.euler_from_quaternion(quaternion, axes), angles)
            for middle in (-math.pi / 2, 0.0, math.pi / 2, math.pi):
                matrix = tf.euler_matrix(0.4, middle, 0.3, axes)
                self.same(tf.euler_matrix(*tf.euler_from_matrix(matrix, axes), axes), matrix)
        for wrong in ("xyz", "sxxy", "qxyz", "sxyw"):
            self.assertRaises(ValueError, tf.euler_matrix, 0, 0, 0, wrong)

    def test_quaternions_of_large_turns(self):
        """About any axis."""
        for axis in (*np.eye(3), [1, 2, 3], [-3, 2, -1]):
            for angle in (3.0, math.pi, -2.5):
                matrix = tf.rotation_matrix(angle, axis)
                self.same(tf.quaternion_matrix(tf.quaternion_from_matrix(matrix)), matrix)
                self.same(tf.quaternion_matrix(tf.quaternion_from_matrix(matrix[:3, :3])), matrix)

    def test_transforms(self):
        """The last of a product is done first."""
        move, turn = tf.translation_matrix([1, 2, 3]), tf.rotation_matrix(math.pi / 2, Z)
        both = tf.concatenate_matrices(move, turn)
        self.same(both @ [1, 0, 0, 1], [1, 3, 3, 1])
        self.same(tf.translation_from_matrix(both), [1, 2, 3])
        self.same(tf.concatenate_matrices(tf.inverse_matrix(both), both), tf.identity_matrix())
        self.same(tf.rotation_matrix(math.pi, Z, [1, 0, 0]) @ [0, 0, 0, 1], [2, 0, 0, 1])
        self.same(tf.unit_vector([0, 3, 4]), [0, 0.6, 0.8])
        self.assertEqual(tf.vector_norm([0, 3, 4]), 5.0)
