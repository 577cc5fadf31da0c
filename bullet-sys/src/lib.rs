//! C interface over the double-precision Bullet Physics library.
