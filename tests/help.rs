//! Contract: every `--help` ends with examples, and every example is a command line that the program takes; completions and
//! manual pages are made for all commands.

use clap::{Command, CommandFactory as _, Parser as _};
use noctule::cli::Arguments;

/// All commands of a tree, with their names.
fn tree(command: &Command, name: &str, found: &mut Vec<(String, Command)>) {
    found.push((name.to_owned(), command.clone()));
    for below in command.get_subcommands().filter(|below| below.get_name() != "help" && !below.is_hide_set()) {
        tree(below, &format!("{name} {}", below.get_name()), found);
    }
}

fn commands() -> Vec<(String, Command)> {
    let mut found = Vec::new();
    tree(&Arguments::command(), "noctule", &mut found);
    tree(&noctule::cli_controller::command(), "noctule-controller", &mut found);
    found
}

/// The lines of the examples at the end of a help text; lines that begin deeper go on with the one before.
fn examples(help: &str) -> Vec<String> {
    let (_, part) = help.rsplit_once("Examples:\n").expect("examples");
    let mut lines: Vec<String> = Vec::new();
    for line in part.lines().filter(|line| !line.trim().is_empty()) {
        match lines.last_mut() {
            Some(last) if line.starts_with("    ") => last.push_str(line),
            _ => lines.push(line.trim_start().to_owned()),
        }
    }
    lines
}

/// The words of the command in an example, without remarks, pipes and files that the shell makes.
fn words(example: &str) -> Vec<String> {
    let command = example.rsplit(" | ").next().expect("a command");
    let command = command.strip_prefix("parallel ").unwrap_or(command);
    let end = ["  ", " #", " > ", " :::"].iter().filter_map(|mark| command.find(mark)).min().unwrap_or(command.len());
    command[..end].split_whitespace().map(|word| word.replace("{}", "1")).collect()
}

/// Why an example is none.
fn refusal(example: &str) -> Option<String> {
    let words = words(example);
    let taken = match words.first().map(String::as_str) {
        Some("noctule") => Arguments::try_parse_from(&words).map(drop),
        Some("noctule-controller") => noctule::cli_controller::command().try_get_matches_from(&words).map(drop),
        _ => return Some(format!("no command of ours: {example}")),
    };
    taken.err().map(|error| error.to_string())
}

#[test]
fn every_help_ends_with_examples_that_are_command_lines() {
    let commands = commands();
    assert!(commands.len() >= 25, "{}", commands.len());
    for (name, mut command) in commands {
        let help = command.render_long_help().to_string();
        assert!(help.contains("Examples:\n"), "{name} --help has no examples");
        // As it is written: a narrow terminal may break lines.
        let examples = examples(&command.get_after_help().expect("examples at the end").to_string());
        assert!(!examples.is_empty(), "{name}");
        for example in examples {
            assert_eq!(refusal(&example), None, "{name}: {example}");
        }
    }
}

#[test]
fn an_example_that_the_program_does_not_take_is_noticed() {
    assert!(refusal("noctule run --sauce sim").is_some());
    assert!(refusal("ls noctule").is_some());
    assert_eq!(refusal("echo '{}' | noctule detect ring     # a remark"), None);
}

#[test]
fn completions_and_pages_are_made_for_every_command() {
    let noctule = || assert_cmd::Command::cargo_bin("noctule").expect("built");
    let folder = tempfile::tempdir().expect("folder");
    noctule().arg("man").arg(folder.path()).assert().success();
    let scripts = ["bash", "zsh", "fish"].map(|shell| {
        let output = noctule().args(["completions", shell]).output().expect("runs");
        assert!(output.status.success());
        String::from_utf8(output.stdout).expect("text")
    });
    for (name, command) in commands() {
        let page = folder.path().join(format!("{}.1", name.replace(' ', "-")));
        let text = std::fs::read_to_string(&page).unwrap_or_else(|error| panic!("{}: {error}", page.display()));
        assert!(text.contains(".TH") && text.contains("Examples:"), "{name}");
        let last = command.get_name();
        assert!(name.starts_with("noctule-controller") || scripts.iter().all(|script| script.contains(last)), "{name}");
    }
    let controller = noctule().args(["completions", "bash", "--controller"]).output().expect("runs");
    assert!(String::from_utf8_lossy(&controller.stdout).contains("noctule-controller"));
}
