//! What makes the simulator's command line tolerant: unknown options and stray words are taken out before clap, which
//! would refuse them, sees the rest.

use super::values::boolean;
use super::CliError;
use clap::{Arg, Command};

/// Long options of the C++ program: a beginning that is unique among them is theirs, whatever else begins so here.
const ORIGINAL: [&str; 17] = [
    "help",
    "ndevs",
    "load_devices",
    "enableforces",
    "phx_frequency",
    "htx_frequency",
    "fixed_phx_timestep",
    "fixed_htx_timestep",
    "override_max_comm_freq",
    "override_min_comm_freq",
    "show_gui",
    "ns",
    "sim_speed_factor",
    "plugins",
    "launch_file",
    "load_multibody_files",
    "load_multibodies",
];

/// The known options of `argv` (program name included) as `--name=value`, and what was taken out, in order.
///
/// A known option takes the next word as its value unless that is itself a known option, so negative numbers can be
/// values. An unknown option's value is a stray word. After `--` all words are stray.
pub(super) fn known_options(command: &Command, argv: &[String]) -> Result<(Vec<String>, Vec<String>), CliError> {
    let mut kept: Vec<String> = argv.iter().take(1).cloned().collect();
    let mut ignored = Vec::new();
    let mut words = argv.iter().skip(1).peekable();
    while let Some(word) = words.next() {
        if word == "--" {
            ignored.extend(words.by_ref().cloned());
            break;
        }
        let Some((argument, attached)) = option(command, word)? else {
            ignored.push(word.clone());
            continue;
        };
        let long = argument.get_long().expect("every option of the simulator has a long name");
        let values = argument.get_num_args().unwrap_or_default();
        let value = match attached {
            Some(value) => Some(value.to_owned()),
            None if values.max_values() == 0 => None,
            None if values.min_values() == 0 => words.next_if(|next| boolean(next).is_ok()).cloned(),
            None => match words.next() {
                Some(next) if option(command, next)?.is_none() => Some(next.clone()),
                _ => return Err(CliError::Usage(format!("error: the option {word} needs a value (try --help)"))),
            },
        };
        kept.push(match value {
            Some(value) => format!("--{long}={value}"),
            None => format!("--{long}"),
        });
    }
    Ok((kept, ignored))
}

/// The option that `word` names, with the value written in the same word; `None` if it names none.
fn option<'c, 'w>(command: &'c Command, word: &'w str) -> Result<Option<(&'c Arg, Option<&'w str>)>, CliError> {
    if let Some(body) = word.strip_prefix("--") {
        let (name, value) = match body.split_once('=') {
            Some((name, value)) => (name, Some(value)),
            None => (body, None),
        };
        return Ok(by_long_name(command, name)?.map(|argument| (argument, value)));
    }
    let Some(body) = word.strip_prefix('-') else {
        return Ok(None);
    };
    let mut letters = body.chars();
    let letter = letters.next();
    let rest = letters.as_str();
    let argument = command.get_arguments().find(|argument| letter.is_some() && argument.get_short() == letter);
    Ok(argument.and_then(|argument| match rest {
        "" => Some((argument, None)),
        // `-hx` is no way to write `-h`.
        _ if argument.get_num_args().unwrap_or_default().max_values() == 0 => None,
        _ => Some((argument, Some(rest.strip_prefix('=').unwrap_or(rest)))),
    }))
}

/// The option with this long name, or the only one whose name starts so, or the only one of the C++ program's.
fn by_long_name<'c>(command: &'c Command, name: &str) -> Result<Option<&'c Arg>, CliError> {
    if name.is_empty() {
        return Ok(None);
    }
    let long = |argument: &&'c Arg| argument.get_long().unwrap_or_default();
    if let Some(exact) = command.get_arguments().find(|argument| long(argument) == name) {
        return Ok(Some(exact));
    }
    let candidates: Vec<&Arg> = command.get_arguments().filter(|argument| long(argument).starts_with(name)).collect();
    let original: Vec<&Arg> =
        candidates.iter().copied().filter(|argument| ORIGINAL.contains(&long(argument))).collect();
    match (&candidates[..], &original[..]) {
        ([], _) => Ok(None),
        ([only], _) | (_, [only]) => Ok(Some(only)),
        _ => {
            let names: Vec<String> = candidates.iter().map(|argument| format!("--{}", long(argument))).collect();
            let names = names.join(", ");
            Err(CliError::Usage(format!("error: --{name} could mean {names}; write more of the name")))
        }
    }
}
