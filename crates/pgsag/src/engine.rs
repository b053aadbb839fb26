//! The only place that chooses what computes.

use anyhow::Result;
use pgsag_splat::backend::{Backend, Limits};
use pgsag_splat::conformance::{self, Report};
use pgsag_splat::cpu::{Cpu, CpuOptions, SimdLevel};

use crate::error::UserError;

/// Work that any device can do.
pub trait Work {
    /// What it gives.
    type Output;

    /// Does it.
    ///
    /// # Errors
    /// The work's own.
    fn on<B: Backend>(self, backend: &B) -> Result<Self::Output>;
}

/// A graphics card as a user sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Card {
    /// What `--device` calls it.
    pub word: String,
    /// Name, kind, driver, limits.
    pub text: String,
    /// Whether it computes on the processor: only taken when it is asked for.
    pub is_software: bool,
    /// What it lacks; empty where it can be used.
    pub lacks: String,
}

/// Does `work` on the device of these settings.
///
/// # Errors
/// An unknown device or level, or the work's own.
pub fn run<W: Work>(device: &str, simd: &str, work: W) -> Result<W::Output> {
    match typed(device)? {
        Typed::Gpu(which) => card::run(which.first().map_or("", String::as_str), work),
        Typed::Auto if !real_cards().is_empty() => card::run("", work),
        Typed::Auto | Typed::Cpu => work.on(&cpu(simd, Limits::default())?),
    }
}

/// In words, what decides results beside the seed: device and SIMD level; then the backends with whose checkpoints this
/// one may go on. Of a graphics card neither name nor driver counts: its results are not the same bytes twice.
///
/// # Errors
/// An unknown device or level.
pub fn describe(device: &str, simd: &str) -> Result<(String, Vec<String>)> {
    let on_cpu = |level: SimdLevel| format!("cpu {}", name(level));
    let on_gpu = match typed(device)? {
        Typed::Cpu => false,
        Typed::Gpu(_) => true,
        Typed::Auto => !real_cards().is_empty(),
    };
    if on_gpu {
        return Ok((GPU.into(), SimdLevel::available().into_iter().map(on_cpu).collect()));
    }
    Ok((on_cpu(level(simd)?), vec![GPU.into()]))
}

/// The devices that slots are handed, one each; none: jobs compute on the processor.
///
/// # Errors
/// A graphics card is asked for where there is none.
pub fn devices(device: &str) -> Result<Vec<String>> {
    Ok(match typed(device)? {
        Typed::Cpu => Vec::new(),
        Typed::Auto => real_cards(),
        Typed::Gpu(which) if which.is_empty() => {
            let found = real_cards();
            if found.is_empty() {
                return Err(none(device, "there is no graphics card that can be used"));
            }
            found
        }
        Typed::Gpu(which) => {
            let cards = card::all().unwrap_or_default();
            let mut words = Vec::new();
            for which in &which {
                let card = asked_for(&cards, which, device)?;
                if !words.contains(&card.word) {
                    words.push(card.word.clone());
                }
            }
            words
        }
    })
}

/// The card of this index or PCI bus id, if it can be used.
fn asked_for<'a>(cards: &'a [Card], which: &str, device: &str) -> Result<&'a Card> {
    let by_index = which.parse().ok().and_then(|index: usize| cards.get(index));
    let is_meant = |card: &&Card| card.word.strip_prefix("gpu:").is_some_and(|word| word.eq_ignore_ascii_case(which));
    match by_index.or_else(|| cards.iter().find(is_meant)) {
        Some(card) if card.lacks.is_empty() => Ok(card),
        Some(card) => Err(none(device, &format!("{} lacks {}", card.text, card.lacks))),
        None => Err(none(device, &format!("there is no graphics card {which}"))),
    }
}

/// Why a card cannot be had, as an error of the one who asked for it.
fn none(device: &str, why: &str) -> anyhow::Error {
    let place = format!("--device {device}");
    if card::all().is_none() {
        let cure = "take a release, or build with: cargo build --release -p pgsag --features gpu";
        return UserError::new(place, "this pgsag was built without graphics cards", cure).into();
    }
    UserError::new(place, why, "`pgsag doctor` lists what there is, and what hides it").into()
}

/// All graphics cards of this machine that this program can see; `None` where it was built without them.
#[must_use]
pub fn cards() -> Option<Vec<Card>> {
    card::all()
}

/// Compares a device with the slow true reference: its name, and the table.
///
/// # Errors
/// An unknown device or level, or a device that cannot be opened.
pub fn self_test(device: &str, simd: &str) -> Result<(String, Report)> {
    match typed(device)? {
        Typed::Gpu(_) => card::self_test(&devices(device)?[0]),
        Typed::Auto if !real_cards().is_empty() => card::self_test(&devices(device)?[0]),
        Typed::Auto | Typed::Cpu => {
            let report = conformance::try_check(|limits| cpu(simd, limits))?;
            Ok((format!("cpu {}", name(level(simd)?)), report))
        }
    }
}

/// The SIMD levels of this machine, best first.
#[must_use]
pub fn levels() -> Vec<String> {
    SimdLevel::available().into_iter().map(name).collect()
}

/// In manifests.
const GPU: &str = "gpu";

/// `--device`, understood.
enum Typed {
    Auto,
    Cpu,
    /// By index or PCI bus id; empty: any.
    Gpu(Vec<String>),
}

fn typed(device: &str) -> Result<Typed> {
    Ok(match device {
        "auto" => Typed::Auto,
        "cpu" => Typed::Cpu,
        "gpu" => Typed::Gpu(Vec::new()),
        cards => {
            let one = |word: &str| word.strip_prefix("gpu:").filter(|which| !which.is_empty()).map(str::to_owned);
            let all: Option<Vec<String>> = cards.split(',').map(|word| one(word.trim())).collect();
            let place = format!("--device {device}");
            let cure = "use auto, cpu, gpu, gpu:N or gpu:N,gpu:M";
            Typed::Gpu(all.ok_or_else(|| UserError::new(place, "there is no such device", cure))?)
        }
    })
}

/// What `--device` calls the cards that can be used and are no software.
fn real_cards() -> Vec<String> {
    let usable = |card: &Card| !card.is_software && card.lacks.is_empty();
    card::all().unwrap_or_default().into_iter().filter(usable).map(|card| card.word).collect()
}

fn name(level: SimdLevel) -> String {
    format!("{level:?}").to_ascii_lowercase()
}

fn level(simd: &str) -> Result<SimdLevel> {
    let found = match simd {
        "auto" => SimdLevel::available().first().copied(),
        typed => SimdLevel::available().into_iter().find(|level| name(*level) == typed),
    };
    found.ok_or_else(|| {
        let cure = format!("use auto or one of {}", levels().join(", "));
        UserError::new(format!("--simd {simd}"), "this machine has no such level", cure).into()
    })
}

fn cpu(simd: &str, limits: Limits) -> Result<Cpu> {
    Ok(Cpu::new(CpuOptions { simd: level(simd)?, limits })?)
}

/// Graphics cards.
#[cfg(feature = "gpu")]
mod card {
    use pgsag_gpu::{Adapter, Backward, DeviceChoice, Gpu, GpuOptions, adapters};
    use pgsag_splat::conformance::Comparison;

    use super::{Card, Report, Result, Work, conformance};

    pub(super) fn all() -> Option<Vec<Card>> {
        Some(adapters().iter().map(card).collect())
    }

    fn card(adapter: &Adapter) -> Card {
        let Adapter { index, name, kind, api, driver, pci_bus_id, largest_binding, subgroup, missing } = adapter;
        let bus = if pci_bus_id.is_empty() { String::new() } else { format!(", PCI {pci_bus_id}") };
        let text = format!(
            "{name} ({kind}, {api}, {driver}{bus}; buffers up to {} MiB, subgroups of {})",
            largest_binding >> 20,
            subgroup.0
        );
        let which = if pci_bus_id.is_empty() { index.to_string() } else { pci_bus_id.clone() };
        Card { word: format!("gpu:{which}"), text, is_software: adapter.is_software(), lacks: missing.join(" and ") }
    }

    pub(super) fn run<W: Work>(which: &str, work: W) -> Result<W::Output> {
        work.on(&open(which)?)
    }

    pub(super) fn self_test(word: &str) -> Result<(String, Report)> {
        let gpu = open(word.trim_start_matches("gpu:"))?;
        let mut report = Report::default();
        let (least, most) = gpu.adapter().subgroup;
        // Training takes the way back that is faster: both must be right. By Gaussians needs subgroups of one width.
        let ways = [("by pixels", Backward::Pixels), ("by Gaussians", Backward::Gaussians)];
        for (way, backward) in ways.into_iter().take(if least == most { 2 } else { 1 }) {
            let found = conformance::try_check(|limits| gpu.with(limits, backward))?;
            let named =
                |comparison: Comparison| Comparison { name: format!("{way}: {}", comparison.name), ..comparison };
            report.comparisons.extend(found.comparisons.into_iter().map(named));
            report.faults.extend(found.faults.into_iter().map(|fault| format!("{way}: {fault}")));
        }
        Ok((card(gpu.adapter()).text, report))
    }

    /// A card that is gone is no mistake of the user's: a job that finds none is tried once more.
    fn open(which: &str) -> Result<Gpu> {
        let device = match (which, which.parse()) {
            ("", _) => DeviceChoice::Best,
            (_, Ok(index)) => DeviceChoice::Index(index),
            _ => DeviceChoice::Pci(which.to_owned()),
        };
        Ok(Gpu::new(&GpuOptions { device, ..GpuOptions::default() })?)
    }
}

/// Graphics cards, of a program that was built without.
#[cfg(not(feature = "gpu"))]
mod card {
    use super::{Card, Report, Result, Work, none};

    pub(super) fn all() -> Option<Vec<Card>> {
        None
    }

    pub(super) fn run<W: Work>(which: &str, _work: W) -> Result<W::Output> {
        Err(none(&format!("gpu:{which}"), ""))
    }

    pub(super) fn self_test(word: &str) -> Result<(String, Report)> {
        Err(none(word, ""))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cards_are_found_by_number_and_by_bus() {
        let card = |word: &str, lacks: &str| Card {
            word: word.into(),
            text: word.into(),
            is_software: false,
            lacks: lacks.into(),
        };
        let cards = [card("gpu:0000:65:00.0", ""), card("gpu:0000:B3:00.0", ""), card("gpu:2", "atomics")];
        let word = |which: &str| asked_for(&cards, which, "gpu").map(|card| card.word.clone());
        assert_eq!(word("1").expect("there"), "gpu:0000:B3:00.0");
        assert_eq!(word("0000:b3:00.0").expect("there"), "gpu:0000:B3:00.0");
        assert!(word("2").is_err() && word("3").is_err() && word("0000:00:00.0").is_err());
    }

    #[test]
    fn a_device_is_understood_or_refused_in_one_line() {
        assert!(matches!(typed("gpu:1"), Ok(Typed::Gpu(which)) if which == ["1"]));
        assert!(matches!(typed("gpu:0000:65:00.0"), Ok(Typed::Gpu(which)) if which == ["0000:65:00.0"]));
        assert!(matches!(typed("gpu:0, gpu:2"), Ok(Typed::Gpu(which)) if which == ["0", "2"]));
        for wrong in ["gpu:", "cuda", "GPU", "", "gpu:0,cpu", "gpu:0,"] {
            let refused = typed(wrong).err().map(|error| error.to_string());
            assert!(refused.is_some_and(|line| line.contains("use auto, cpu, gpu, gpu:N")), "{wrong}");
        }
    }

    #[test]
    fn a_checkpoint_may_cross_between_processor_and_card_but_not_between_levels() {
        let (cpu, kindred) = describe("cpu", "auto").expect("there is a processor");
        assert_eq!(kindred, [GPU]);
        let (gpu, kindred) = describe("gpu:7", "auto").expect("it is not opened");
        assert_eq!(gpu, GPU);
        assert!(kindred.contains(&cpu));
        assert!(devices("cpu").expect("none").is_empty());
    }
}
