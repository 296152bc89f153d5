use super::*;
use std::cell::{Cell, RefCell};

#[test]
fn a_network_without_authentication_is_not_closed() {
    let folder = std::env::temp_dir().join(format!("csi5300-network-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let refused = |zenoh: &str, users: &str, group: &str| {
        std::fs::write(folder.join("users"), users).unwrap();
        let zenoh = zenoh.replace("FOLDER", &folder.display().to_string());
        std::fs::write(folder.join("zenoh.json5"), zenoh).unwrap();
        let asked = Asked { zenoh: Some(folder.join("zenoh.json5")), group: group.into(), ..Asked::default() };
        refusal(&asked, &[]).unwrap_or_default()
    };
    let with = |file: &str| {
        r#"{listen:{endpoints:["tcp/0.0.0.0:7447"]},transport:{auth:{usrpwd:{dictionary_file:"FOLDER/FILE"}}}}"#
            .replace("FILE", file)
    };
    assert_eq!(refused(&with("users"), "burger-1:secret\n", "lab"), "");
    assert!(refused(&with("users"), " \n\n", "lab").contains("users names no user"));
    assert!(refused(&with("none"), "burger-1:secret\n", "lab").contains("none names no user"));
    let tls = |settings: &str| {
        r#"{listen:{endpoints:["tls/0.0.0.0:7448SETTINGS"]},transport:{link:{tls:{enable_mtls:true}}}}"#
            .replace("SETTINGS", settings)
    };
    assert_eq!(refused(&tls("#iface=lo"), "", "lab"), "");
    let without = refused(&tls("#iface=lo;enable_mtls=false"), "", "lab");
    assert!(without.contains("anybody who reaches tls/0.0.0.0:7448"), "{without}");
    for group in ["**", "a/b", "a*", "a#b", "a b"] {
        assert!(refused(&with("users"), "burger-1:secret\n", group).contains("group"), "{group}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn the_publisher_ends_although_items_keep_coming() {
    let (items, waiting) = sync_channel(10);
    let send = || drop(items.try_send(Item::Record(0, None, 0xBB, vec![1])));
    (0..3).for_each(|_| send());
    let sent = Cell::new(0);
    let take = |message: Vec<u8>| {
        sent.set(sent.get() + usize::from(!message.is_empty()));
        send();
    };
    work(&waiting, 7, &AtomicBool::new(true), take, |_| {});
    assert!(sent.get() >= LAST_MESSAGES, "{}", sent.get());
    work(&waiting, 7, &AtomicBool::new(true), |_| {}, |_| {});
    assert!(waiting.try_recv().is_err(), "what waited was sent");
}

#[test]
fn dropped_items_are_missed_by_the_peers() {
    let (items, waiting) = sync_channel(2);
    let unsent = Arc::new(AtomicU64::new(0));
    let tap = RefCell::new(Published::new(items, Arc::clone(&unsent), (true, false)));
    let offer = || tap.borrow_mut().record(None, Record { code: 0xBB, body: &[1] });
    (0..5).for_each(|_| offer());
    let (mailbox, first) = (Mailbox::new(100), Cell::new(true));
    let send = |message: Vec<u8>| {
        mailbox.put(&message);
        if first.replace(false) {
            offer();
        }
    };
    work(&waiting, 7, &AtomicBool::new(true), send, |_| {});
    let counts = mailbox.counts();
    assert_eq!((counts.received, counts.missing, unsent.load(Ordering::Relaxed)), (3, 3, 3));
}
