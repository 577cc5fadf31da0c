//! What the command line says to the drill, as the C++ plugin reads it. Words that mean something else are left alone.

/// What the command line says.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Balls that touch: the tip, and others along the shaft; 1 to 8. Default: 8.
    pub balls: usize,
    /// Between balls along the shaft, m; positive. Default: 0.0015.
    pub spacing: f64,
    /// Name of the body that is led. Default: `mastoidectomy_drill`.
    pub body: String,
    /// Name of the only volume that it touches. Default: all.
    pub volume: Option<String>,
    /// Whether a burr removes a number of voxels, as the C++ plugin does, instead of cutting at a rate. Default: `false`.
    pub counts: bool,
}

impl Default for Options {
    fn default() -> Self {
        let (balls, spacing, body) = (MOST_BALLS, 0.0015, "mastoidectomy_drill".into());
        Self { balls, spacing, body, volume: None, counts: false }
    }
}

/// Most balls.
const MOST_BALLS: usize = 8;

/// Options of the C++ plugin without effect here.
const WITHOUT_EFFECT: [&str; 5] = ["--vm", "--dm", "--fp", "--mute", "--gcdr"];

impl Options {
    /// Reads a command line; also a sentence for each option of the C++ plugin that has no effect.
    ///
    /// # Errors
    /// A sentence about the option that cannot be used.
    pub fn read(words: &[String]) -> Result<(Self, Vec<String>), String> {
        let mut options = Self::default();
        let mut remarks = Vec::new();
        let mut words = words.iter();
        while let Some(word) = words.next() {
            let (name, attached) = match word.split_once('=') {
                Some((name, value)) => (name, Some(value)),
                None => (word.as_str(), None),
            };
            let mut value = || {
                let value = attached.or_else(|| words.next().map(String::as_str));
                value.ok_or_else(|| format!("the option {name} needs a value"))
            };
            match name {
                "--nt" => {
                    let text = value()?;
                    let balls = text.parse().ok().filter(|balls| (1..=MOST_BALLS).contains(balls));
                    let expected = || format!("--nt is `{text}`, expected a number of balls from 1 to {MOST_BALLS}");
                    options.balls = balls.ok_or_else(expected)?;
                }
                "--ds" => {
                    let text = value()?;
                    let spacing = text.parse().ok().filter(|spacing: &f64| spacing.is_finite() && *spacing > 0.0);
                    options.spacing =
                        spacing.ok_or_else(|| format!("--ds is `{text}`, expected a length above 0, m"))?;
                }
                "--drill_body" => options.body = value()?.to_owned(),
                "--anatomy_volume_name" => options.volume = Some(value()?.to_owned()),
                "--removal" => {
                    options.counts = match value()? {
                        "count" => true,
                        "rate" => false,
                        other => return Err(format!("--removal is `{other}`, expected `rate` or `count`")),
                    };
                }
                _ if WITHOUT_EFFECT.contains(&name) => remarks.push(format!("{name} has no effect here")),
                _ => {}
            }
        }
        Ok((options, remarks))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> Result<(Options, Vec<String>), String> {
        Options::read(&line.split(' ').map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn options_of_the_cpp_plugin_are_read_among_others() {
        assert_eq!(read("ambf -l 0,1 -g 0"), Ok((Options::default(), vec![])));
        let (options, remarks) = read("ambf --nt 3 -p 500 --ds=0.002 --fp /dev/input/js1 --removal count").unwrap();
        assert_eq!((options.balls, options.spacing, options.counts), (3, 0.002, true));
        assert_eq!(remarks, ["--fp has no effect here"]);
        let (options, _) = read("ambf --drill_body tool --anatomy_volume_name cube --removal rate").unwrap();
        assert_eq!((options.body.as_str(), options.volume.as_deref(), options.counts), ("tool", Some("cube"), false));
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        for (line, expected) in [
            ("ambf --nt 9", "--nt is `9`, expected a number of balls from 1 to 8"),
            ("ambf --nt 0", "--nt is `0`"),
            ("ambf --ds -1", "--ds is `-1`"),
            ("ambf --ds", "--ds needs a value"),
            ("ambf --removal some", "expected `rate` or `count`"),
        ] {
            assert!(read(line).unwrap_err().contains(expected), "{line}");
        }
    }
}
