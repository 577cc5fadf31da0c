//! Pictures from any bytes. What no content tells is read as tga.
#![no_main]

use ambf_render::Texture;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    match Texture::parse(data, std::path::Path::new("t.tga")) {
        Ok(texture) => {
            let (width, height) = (u64::from(texture.width), u64::from(texture.height));
            assert!(width.min(height) > 0 && width.max(height) <= 16384);
            assert!(texture.rgba.len() as u64 == 4 * width * height && texture.rgba.len() <= 256 << 20);
        }
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with("t.tga") && message.len() < 2000, "{message}");
        }
    }
});
