//! Named steps that run one after another, each with its time, and a summary at the end.

use std::path::Path;
use std::process::Command;

use crate::Result;
use crate::clock::{Clock, Spent};

/// A command in the repository's root, shown as a person would type it.
pub(crate) fn shell(root: &Path, program: &str, arguments: &[&str]) -> Result<()> {
    shell_with(root, program, arguments, &[])
}

/// The same with environment variables.
pub(crate) fn shell_with(root: &Path, program: &str, arguments: &[&str], variables: &[(&str, &str)]) -> Result<()> {
    let typed = typed(program, arguments, variables);
    println!("$ {typed}");
    let mut command = Command::new(program);
    let status = command.args(arguments).envs(variables.iter().copied()).current_dir(root).status();
    match status {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("`{typed}` failed ({status})")),
        Err(cause) => Err(format!("cannot start `{program}`: {cause}")),
    }
}

/// What a command prints on standard output.
pub(crate) fn output_of(root: &Path, program: &str, arguments: &[&str]) -> Result<String> {
    let run = Command::new(program).args(arguments).current_dir(root).stderr(std::process::Stdio::inherit()).output();
    let output = run.map_err(|cause| format!("cannot start `{program}`: {cause}"))?;
    if !output.status.success() {
        return Err(format!("`{}` failed ({})", typed(program, arguments, &[]), output.status));
    }
    String::from_utf8(output.stdout).map_err(|_| format!("`{program}` printed something that is not UTF-8"))
}

fn typed(program: &str, arguments: &[&str], variables: &[(&str, &str)]) -> String {
    let mut words: Vec<String> = variables.iter().map(|(name, value)| format!("{name}='{value}'")).collect();
    words.push(program.to_owned());
    words.extend(arguments.iter().map(|word| (*word).to_owned()));
    words.join(" ")
}

/// Runs steps to the end, also past a failure: one run shows all that is wrong.
#[derive(Default)]
pub(crate) struct Steps {
    done: Vec<(&'static str, Spent, Option<String>)>,
}

impl Steps {
    pub(crate) fn run(&mut self, name: &'static str, step: impl FnOnce() -> Result<()>) {
        println!("\n== {name}");
        let clock = Clock::start();
        let failure = step().err();
        let spent = clock.stop();
        if let Some(message) = &failure {
            println!("{message}");
        }
        println!("== {name}: {} {spent}", if failure.is_some() { "FAILED" } else { "ok" });
        self.done.push((name, spent, failure));
    }

    /// The table of all steps; an error that names those that failed.
    pub(crate) fn finish(self) -> Result<()> {
        println!("\n{}", self.summary());
        let failed: Vec<&str> = self.done.iter().filter(|step| step.2.is_some()).map(|step| step.0).collect();
        if failed.is_empty() { Ok(()) } else { Err(format!("failed: {}", failed.join(", "))) }
    }

    fn summary(&self) -> String {
        let mut total = Spent { wall_secs: 0.0, cpu_secs: Some(0.0) };
        let mut lines = Vec::new();
        for (name, spent, failure) in &self.done {
            total.wall_secs += spent.wall_secs;
            total.cpu_secs = total.cpu_secs.zip(spent.cpu_secs).map(|(sum, secs)| sum + secs);
            lines.push(format!("{name:<10} {:<6} {spent}", if failure.is_some() { "FAILED" } else { "ok" }));
        }
        lines.push(format!("{:<10} {:<6} {total}", "total", ""));
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_does_not_stop_the_rest_and_is_named() {
        let mut steps = Steps::default();
        let mut reached = false;
        steps.run("first", || Err("broken".to_owned()));
        steps.run("second", || {
            reached = true;
            Ok(())
        });
        assert!(reached);
        assert!(steps.summary().contains("first      FAILED"));
        assert_eq!(steps.finish(), Err("failed: first".to_owned()));
    }

    #[test]
    fn a_command_is_shown_as_typed() {
        assert_eq!(
            typed("cargo", &["doc"], &[("RUSTDOCFLAGS", "-D warnings")]),
            "RUSTDOCFLAGS='-D warnings' cargo doc"
        );
    }
}
