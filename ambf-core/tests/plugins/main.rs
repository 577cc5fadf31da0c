//! Plugins and their libraries, one program: see `../simulation/main.rs`.

mod driver_library;
mod plugin_calls;
mod plugin_common;
mod plugin_library;
mod plugins_view;
