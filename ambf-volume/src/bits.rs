//! Sets of the 8³ voxels of a brick, or of the bricks of a chunk: a word a layer in z, bit x + 8 y.

/// 512 bits.
pub(crate) type Mask = [u64; 8];

/// No bit.
pub(crate) const NONE: Mask = [0; 8];

pub(crate) fn has(mask: &Mask, place: usize) -> bool {
    mask[place / 64] >> (place % 64) & 1 == 1
}

pub(crate) fn put(mask: &mut Mask, place: usize, is_set: bool) {
    let bit = 1 << (place % 64);
    match is_set {
        true => mask[place / 64] |= bit,
        false => mask[place / 64] &= !bit,
    }
}

pub(crate) fn count(mask: &Mask) -> usize {
    mask.iter().map(|word| word.count_ones() as usize).sum()
}

/// Places of the bits of a word.
pub(crate) fn ones_of(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = (word != 0).then_some(word.trailing_zeros() as usize)?;
        word &= word - 1;
        Some(place)
    })
}

/// Places of all bits.
pub(crate) fn ones(mask: &Mask) -> impl Iterator<Item = usize> + '_ {
    mask.iter().enumerate().flat_map(|(word, &bits)| ones_of(bits).map(move |place| 64 * word + place))
}
