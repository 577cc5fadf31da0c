//! Prints where the fake HD library is.

fn main() {
    println!("{}", fake_hd::LIBRARY);
}
