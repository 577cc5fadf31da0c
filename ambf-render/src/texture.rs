//! shim
use std::path::Path;
/// t
pub struct Texture { /// w
pub width: u32, /// h
pub height: u32, /// r
pub rgba: Vec<u8> }
/// e
#[derive(Debug, thiserror::Error)]
#[error("shim")]
pub struct TextureError;
impl Texture { /// l
pub fn load(_p: &Path) -> Result<Self, TextureError> { Err(TextureError) } }
