//! Where windows open, as pure functions.

/// Part of a screen, in pixels: left, top, width, height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Area {
    pub left: i32,
    pub top: i32,
    pub width: u32,
    pub height: u32,
}

/// How far each further window of a monitor is shifted, pixels.
const SHIFT: i32 = 30;

/// Where the `nth` window (from 0) of a monitor opens: 80 % x 50 % of it, or `size`, centred, and shifted so that no
/// two coincide.
pub(crate) fn window_area(monitor: &Area, size: Option<(u32, u32)>, nth: usize) -> Area {
    let (width, height) = size.unwrap_or((monitor.width * 4 / 5, monitor.height / 2));
    let (width, height) = (width.max(1), height.max(1));
    // So many shifts stay on the screen.
    let room = (monitor.height.saturating_sub(height) / 2 / SHIFT as u32).max(1) as usize;
    let shift = SHIFT * (nth % (room + 1)) as i32;
    let middle = |start: i32, whole: u32, part: u32| start + (i64::from(whole) - i64::from(part)).div_euclid(2) as i32;
    Area {
        left: middle(monitor.left, monitor.width, width) + shift,
        top: middle(monitor.top, monitor.height, height) + shift,
        width,
        height,
    }
}

/// The monitor of the `camera`-th camera (from 0) of `count` monitors, and whether the one that was asked for is
/// missing.
pub(crate) fn monitor_index(wanted: Option<u32>, camera: usize, count: usize) -> (usize, bool) {
    let fallback = if camera < count { camera } else { 0 };
    match wanted {
        Some(wanted) if (wanted as usize) < count => (wanted as usize, false),
        Some(_) => (fallback, true),
        None => (fallback, false),
    }
}

/// Title of the window of the `camera`-th camera, from 0.
pub(crate) fn title(camera: usize, devices: &[String]) -> String {
    let mut title = format!("AMBF Simulator Window {}", camera + 1);
    for device in devices {
        title += " - ";
        title += device;
    }
    title
}

#[cfg(test)]
mod tests {
    use super::*;

    const MONITOR: Area = Area { left: 100, top: 0, width: 800, height: 960 };

    #[test]
    fn windows_are_centred_and_do_not_coincide() {
        let first = window_area(&MONITOR, None, 0);
        assert_eq!(first, Area { left: 180, top: 240, width: 640, height: 480 });
        let second = window_area(&MONITOR, None, 1);
        assert_eq!((second.left, second.top), (210, 270));
        for nth in 0..100 {
            let area = window_area(&MONITOR, None, nth);
            assert!(area.top + area.height as i32 <= 960 + SHIFT, "{nth}: {area:?}");
        }
        let own = window_area(&MONITOR, Some((200, 100)), 0);
        assert_eq!(own, Area { left: 400, top: 430, width: 200, height: 100 });
        let large = window_area(&MONITOR, Some((4000, 4000)), 3);
        assert_eq!((large.width, large.height), (4000, 4000));
        assert!(window_area(&Area { width: 0, height: 0, ..MONITOR }, None, 0).width > 0);
    }

    #[test]
    fn row_15_a_monitor_that_is_not_there_is_replaced_and_said() {
        assert_eq!(monitor_index(Some(7), 0, 1), (0, true));
        assert_eq!(monitor_index(Some(1), 0, 2), (1, false));
        assert_eq!(monitor_index(Some(7), 1, 2), (1, true));
        assert_eq!(monitor_index(None, 1, 2), (1, false));
        assert_eq!(monitor_index(None, 5, 2), (0, false));
    }

    #[test]
    fn row_14_titles_name_the_controlling_devices() {
        assert_eq!(title(0, &[]), "AMBF Simulator Window 1");
        assert_eq!(title(1, &["A".into(), "B".into()]), "AMBF Simulator Window 2 - A - B");
    }
}
