use super::*;

fn adapter(index: usize, kind: &'static str, pci: &str) -> Adapter {
    Adapter {
        index,
        name: format!("card {index}"),
        kind,
        api: "vulkan".into(),
        driver: String::new(),
        pci_bus_id: pci.into(),
        largest_binding: 1 << 31,
        subgroup: (32, 32),
        missing: Vec::new(),
    }
}

#[test]
fn a_software_adapter_is_taken_only_when_asked_for() {
    let all =
        [adapter(0, "software", ""), adapter(1, "integrated", "0000:00:02.0"), adapter(2, "discrete", "0000:65:00.0")];
    assert_eq!(choose(&all, &DeviceChoice::Best).ok(), Some(2));
    assert_eq!(choose(&all[..2], &DeviceChoice::Best).ok(), Some(1));
    assert_eq!(choose(&all, &DeviceChoice::Software).ok(), Some(0));
    assert_eq!(choose(&all, &DeviceChoice::Index(0)).ok(), Some(0));
    assert_eq!(choose(&all, &DeviceChoice::Pci("0000:65:00.0".into())).ok(), Some(2));
    let refused = choose(&all[..1], &DeviceChoice::Best).map_err(|error| error.to_string());
    assert!(refused.is_err_and(|message| message.contains("card 0 (software")));
    assert!(choose(&all, &DeviceChoice::Index(3)).is_err());
}

#[test]
fn a_card_that_lacks_something_is_refused_by_name() {
    let mut all = [adapter(0, "discrete", ""), adapter(1, "discrete", "")];
    all[0].missing = vec!["subgroup operations"];
    assert_eq!(choose(&all, &DeviceChoice::Best).ok(), Some(1));
    let refused = choose(&all, &DeviceChoice::Index(0)).map_err(|error| error.to_string());
    assert_eq!(refused, Err("device: card 0 lacks subgroup operations".into()));
}
