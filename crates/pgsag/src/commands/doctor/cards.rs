//! Graphics cards: which there are, and what hides one from a container.

use std::path::Path;

use super::{Finding, Severity};
use crate::engine::{self, Card};

/// What the machine says beside Vulkan.
#[derive(Clone, Copy, Debug, Default)]
struct Signs {
    /// NVIDIA's driver runs.
    nvidia: bool,
    /// Some driver has said where its Vulkan is.
    has_manifest: bool,
    /// A card of any maker has a device file.
    has_render_node: bool,
}

/// One line per card, or why there is none.
pub(super) fn findings() -> Vec<Finding> {
    let Some(cards) = engine::cards() else {
        let cure = "to compute on a graphics card, take a release, or build with --features gpu";
        return vec![Finding::new(Severity::Note, "gpu", "this pgsag was built without graphics cards", cure)];
    };
    let mut findings: Vec<Finding> = cards.iter().map(line).collect();
    let is_real = |card: &&Card| !card.is_software;
    if cards.iter().filter(is_real).count() == 0 {
        findings.push(hidden(signs()));
    }
    findings
}

fn line(card: &Card) -> Finding {
    let (text, note) = (format!("{} {}", card.word, card.text), Severity::Note);
    match (card.lacks.as_str(), card.is_software) {
        ("", false) => Finding::new(note, "gpu", text, ""),
        ("", true) => Finding::new(note, "gpu", text, &format!("it is slow, and taken only by --device {}", card.word)),
        (lacks, _) => Finding::new(note, "gpu", format!("{text} lacks {lacks}"), "a newer driver may have it"),
    }
}

/// Why no real card can be seen, and what to do.
fn hidden(signs: Signs) -> Finding {
    let Signs { nvidia, has_manifest, has_render_node } = signs;
    if nvidia {
        let cure = "start the container with NVIDIA_DRIVER_CAPABILITIES=all (it must hold `graphics`); where the driver's \
                    nvidia_icd.json is in no usual folder, give its path in VK_DRIVER_FILES";
        let text = "an NVIDIA card is there, but its Vulkan driver is hidden";
        return Finding::new(Severity::Warning, "gpu-hidden", text, cure);
    }
    if has_render_node && !has_manifest {
        let cure = "install the loader and the card's driver (Debian: libvulkan1 mesa-vulkan-drivers)";
        return Finding::new(Severity::Warning, "gpu-hidden", "a graphics card is there, but no Vulkan driver", cure);
    }
    Finding::new(Severity::Note, "gpu", "no graphics card is visible; everything is computed on the processor", "")
}

fn signs() -> Signs {
    let any_file = |folder: &str, begins: &str| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.into_iter().any(|entry| entry.file_name().to_string_lossy().starts_with(begins))
    };
    let folders = ["/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d"];
    Signs {
        nvidia: Path::new("/proc/driver/nvidia/version").exists() || Path::new("/dev/nvidiactl").exists(),
        has_manifest: folders.iter().any(|folder| any_file(folder, "")),
        has_render_node: any_file("/dev/dri", "renderD"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_card_that_a_container_hides_is_named_with_its_remedy() {
        let found = hidden(Signs { nvidia: true, ..Signs::default() });
        assert_eq!(found.severity, Severity::Warning);
        assert!(found.cure.contains("NVIDIA_DRIVER_CAPABILITIES=all") && found.cure.contains("VK_DRIVER_FILES"));
        let found = hidden(Signs { has_render_node: true, ..Signs::default() });
        assert!(found.cure.contains("libvulkan1"));
        assert_eq!(hidden(Signs::default()).severity, Severity::Note);
    }

    #[test]
    fn a_software_card_says_how_it_is_asked_for() {
        let card = Card { word: "gpu:0".into(), text: "llvmpipe".into(), is_software: true, lacks: String::new() };
        assert!(line(&card).cure.contains("--device gpu:0"));
    }
}
