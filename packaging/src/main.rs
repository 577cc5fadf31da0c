//! Writes completions of bash, zsh and fish and the manual page of programs below a folder, where Debian has them:
//!
//! ```text
//! shell_files FOLDER PROGRAM…
//! ```

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Command;
use clap_complete::{generate, Shell};
use clap_mangen::Man;

/// The command line of a program of a package; `None` for another name.
fn command(program: &str) -> Option<Command> {
    match program {
        "ambf_simulator" => Some(ambf_app::cli::SimulatorOptions::command()),
        "ambf_batch" => Some(ambf_app::cli::BatchOptions::command()),
        "fake_dvrk" => Some(fake_dvrk::cli::command()),
        _ => None,
    }
}

/// The files of a program: their places below `/`, and what they hold.
///
/// # Errors
/// When a manual page cannot be made.
fn files(mut command: Command) -> io::Result<Vec<(PathBuf, Vec<u8>)>> {
    let program = command.get_name().to_owned();
    let page = manual_page(&command)?;
    let mut completion = |shell| {
        let mut script = Vec::new();
        generate(shell, &mut command, &program, &mut script);
        script
    };
    Ok([
        (format!("usr/share/bash-completion/completions/{program}"), completion(Shell::Bash)),
        (format!("usr/share/zsh/vendor-completions/_{program}"), completion(Shell::Zsh)),
        (format!("usr/share/fish/vendor_completions.d/{program}.fish"), completion(Shell::Fish)),
        (format!("usr/share/man/man1/{program}.1"), page),
    ]
    .map(|(file, text)| (file.into(), text))
    .into())
}

fn manual_page(command: &Command) -> io::Result<Vec<u8>> {
    let mut page = Vec::new();
    Man::new(command.clone()).manual("AMBF simulator").render(&mut page)?;
    let page = String::from_utf8(page).map_err(io::Error::other)?;
    // What stands behind the options.
    Ok(page.replace("\n.SH EXTRA\n", "\n.SH NOTES\n").into_bytes())
}

fn write(folder: &Path, programs: &[String]) -> io::Result<()> {
    for program in programs {
        let command =
            command(program).ok_or_else(|| io::Error::other(format!("{program} is no program of a package")))?;
        for (file, text) in files(command)? {
            let file = folder.join(file);
            fs::create_dir_all(file.parent().expect("a file in a folder"))?;
            fs::write(file, text)?;
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (folder, programs) = match arguments.split_first() {
        Some((folder, programs)) if !programs.is_empty() => (Path::new(folder), programs),
        _ => {
            eprintln!("usage: shell_files FOLDER PROGRAM…");
            return ExitCode::FAILURE;
        }
    };
    match write(folder, programs) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("shell_files: {error}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command as Process, Output};

    const PROGRAMS: [&str; 3] = ["ambf_simulator", "ambf_batch", "fake_dvrk"];

    /// The files of all programs.
    fn written() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &PROGRAMS.map(String::from)).unwrap();
        folder
    }

    /// What a program of the system says, with a file as its last argument; `None` where it is not installed.
    fn said(program: &str, arguments: &[&str], file: &Path) -> Option<Output> {
        let output = Process::new(program).args(arguments).arg(file).output();
        if output.is_err() {
            println!("SKIPPED: {program} is not installed");
        }
        output.ok()
    }

    #[test]
    fn shells_read_their_scripts() {
        let folder = written();
        let shells = [
            ("bash", "-n", "bash-completion/completions/PROGRAM"),
            ("zsh", "-n", "zsh/vendor-completions/_PROGRAM"),
            ("fish", "--no-execute", "fish/vendor_completions.d/PROGRAM.fish"),
        ];
        for (shell, option, place) in shells {
            for program in PROGRAMS {
                let file = folder.path().join("usr/share").join(place.replace("PROGRAM", program));
                assert!(file.is_file(), "{}", file.display());
                if let Some(output) = said(shell, &[option], &file) {
                    assert!(output.status.success() && output.stderr.is_empty(), "{shell} {program}: {output:?}");
                }
            }
        }
    }

    /// What bash offers for the last of `words`.
    fn offered(folder: &Path, words: &[&str]) -> Vec<String> {
        let program = words[0];
        let script = folder.join("usr/share/bash-completion/completions").join(program);
        let last = words.len() - 1;
        let ask = format!(
            "source '{script}'; COMP_WORDS=({all}); COMP_CWORD={last}; _{program} {program} '{word}' '{before}'; \
             printf '%s\\n' \"${{COMPREPLY[@]}}\"",
            script = script.display(),
            all = words.iter().map(|word| format!("'{word}' ")).collect::<String>(),
            word = words[last],
            before = words[last - 1],
        );
        let output = Process::new("bash").args(["--norc", "-c", &ask]).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap().lines().map(String::from).collect()
    }

    #[test]
    fn bash_completes_options_and_their_values() {
        let folder = written();
        let offered = |words: &[&str]| offered(folder.path(), words);
        assert_eq!(offered(&["ambf_simulator", "--pro"]), ["--profile"]);
        assert_eq!(offered(&["ambf_simulator", "-g", "0", "--launch_f"]), ["--launch_file"]);
        assert_eq!(offered(&["ambf_simulator", "--profile", "acc"]), ["accurate"]);
        assert_eq!(offered(&["ambf_batch", "--render-depth", "n"]), ["npy"]);
        assert_eq!(offered(&["fake_dvrk", "--motion", ""]), ["curve", "still"]);
    }

    #[test]
    fn manual_pages_have_every_option() {
        let folder = written();
        for program in PROGRAMS {
            let file = folder.path().join(format!("usr/share/man/man1/{program}.1"));
            let page = fs::read_to_string(&file).unwrap();
            assert!(page.contains(&format!(".SH NAME\n{program} ")), "{page}");
            let options: Vec<String> = command(program)
                .unwrap()
                .get_arguments()
                .filter_map(|one| Some(one.get_long()?.replace('-', "\\-")))
                .collect();
            assert!(options.len() > 10);
            for option in options {
                assert!(page.contains(&format!("\\-\\-{option}")), "{program} --{option}");
            }
            if let Some(output) = said("groff", &["-man", "-Kutf8", "-Tutf8", "-ww", "-z"], &file) {
                assert!(output.status.success() && output.stderr.is_empty(), "{program}: {output:?}");
            }
        }
    }

    #[test]
    fn other_programs_are_refused() {
        assert!(write(Path::new("/nowhere"), &["roscore".to_owned()]).unwrap_err().to_string().contains("roscore"));
    }
}
