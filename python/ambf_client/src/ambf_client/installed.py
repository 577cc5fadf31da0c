"""Imported first: says what is missing before the messages are imported."""

from .versions import check_packages

check_packages()
