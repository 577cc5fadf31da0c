"""Domains of ROS 2 for tests."""

import random
import socket

# Names in the system's table of sockets, which forgets those of a process that ends, however it ends.
_taken = {}


def take():
    """A domain (1 to 100) that no other test has until it is given back or this process ends."""
    numbers = list(range(1, 101))
    random.SystemRandom().shuffle(numbers)
    for number in numbers:
        mark = socket.socket(socket.AF_UNIX)
        try:
            mark.bind(f"\0ambf-tests-domain-{number}")
        except OSError:
            mark.close()
            continue
        _taken[number] = mark
        return number
    raise RuntimeError("all domains from 1 to 100 are taken by tests that run now")


def give_back(number):
    """Others may take it."""
    _taken.pop(number).close()
