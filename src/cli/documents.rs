//! `noctule completions` and `noctule man`: what a package installs beside the programs, made from the command line itself.

use super::args::{CompletionsArguments, ManArguments};
use super::output::{NewFile, make_folder, print_line};
use super::{Arguments, Failure, exit};
use clap::{Command, CommandFactory as _};
use clap_mangen::Man;
use std::io::Write as _;
use std::path::Path;

/// Prints the script for a shell.
///
/// # Errors
/// Exit 74.
pub fn completions(arguments: &CompletionsArguments) -> Result<(), Failure> {
    let mut command = if arguments.controller { crate::cli_controller::command() } else { Arguments::command() };
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, name, &mut script);
    print_line(String::from_utf8_lossy(&script).trim_end())
}

/// Writes `noctule.1`, a page for each command, and `noctule-controller.1`.
///
/// # Errors
/// Exit 73, 74 or 77.
pub fn man(arguments: &ManArguments) -> Result<(), Failure> {
    make_folder(&arguments.out)?;
    // `help` lists what the pages tell already.
    let mut command = Arguments::command().disable_help_subcommand(true);
    command.build();
    let count = pages(&command, &arguments.out)?;
    // The binary and `noctule controller` would both be noctule-controller(1): the binary's page is the one that is looked for.
    page(crate::cli_controller::command(), &arguments.out)?;
    print_line(&format!("{count} pages in {}", arguments.out.display()))
}

/// Writes the page of a command and of all below it; gives their number.
fn pages(command: &Command, folder: &Path) -> Result<usize, Failure> {
    page(command.clone(), folder)?;
    let below = command.get_subcommands().filter(|below| !below.is_hide_set());
    below.map(|below| pages(below, folder)).try_fold(1, |sum, count| Ok(sum + count?))
}

fn page(command: Command, folder: &Path) -> Result<(), Failure> {
    let man = Man::new(command);
    let mut text = Vec::new();
    man.render(&mut text).map_err(|error| Failure::new(exit::INTERNAL, error))?;
    let mut file = NewFile::create(&folder.join(man.get_filename()))?;
    file.write_all(&text).map_err(|error| file.failure(&error))?;
    file.finish()
}
