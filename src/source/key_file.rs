//! Files with keys: of a group, and of one robot.
//!
//! A group's file holds its secret: 32 or 64 hexadecimal digits, or 16 or 32 bytes. Whoever has it can make every frame of the
//! group. A robot's file holds only what this robot needs (see [`Key::for_robot`]):
//!
//! ```text
//! csi5300 robot key 1
//! robot 02:00:00:00:00:01 GROUP'S KEY, 32 hexadecimal digits
//! 02:00:00:00:00:02 KEY WITH THIS ROBOT, 32 hexadecimal digits
//! ```
//!
//! A file that others than its owner and group can read or write is refused, and a secret that cannot be random too: few
//! different bytes, steps of one size, printable text.

use super::Error;
use crate::exchange::tdma::Key;
use driver_iface::Mac;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::{Read, Write as _};
use std::path::Path;
use zeroize::Zeroizing;

/// First line of a robot's file.
const ROBOT: &str = "csi5300 robot key 1";
/// No key is longer: a robot's has a line of 51 bytes for each of at most a thousand peers.
const LONGEST: u64 = 1 << 16;
/// Mode bits that a key's file may not have: written by its group, anything by others. (Its group may read it: an access
/// control list, as systemd sets one on credentials, shows as that.)
const REFUSED_MODE: u32 = 0o027;

/// Reads a key of either kind.
///
/// # Errors
/// [`Error::Io`], [`Error::NotAFile`], [`Error::Key`]: nothing is taken that is not certain to be a key.
pub fn read_key(path: &Path) -> Result<Key, Error> {
    let name = path.display();
    let failed = |source| Error::Io { what: format!("the key {name}"), source };
    // Opening a pipe would wait.
    if !std::fs::metadata(path).map_err(failed)?.is_file() {
        return Err(Error::NotAFile { path: path.to_owned() });
    }
    let file = std::fs::File::open(path).map_err(failed)?;
    // Of what was opened: another file may be there by now.
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() {
        return Err(Error::NotAFile { path: path.to_owned() });
    }
    if let Some(mode) = refused_mode(&metadata) {
        let why = format!("the key {name} has mode {mode:04o}, so others can read or change it: chmod 600 {name}");
        return Err(Error::Key(why));
    }
    let mut bytes = Zeroizing::new(Vec::with_capacity(LONGEST as usize));
    file.take(LONGEST).read_to_end(&mut bytes).map_err(failed)?;
    let refused = |what: &str| Error::Key(format!("{name}: {what} `csi5300 key new`"));
    let weak = || refused("this key can be guessed (text, repetitions or a sequence): make one with");
    if let Some(robot) = RobotKeys::parse(&bytes) {
        return robot.key().ok_or_else(weak);
    }
    let shape = "a key is 32 or 64 hexadecimal digits or 16 or 32 bytes, or a robot's key file; make one with";
    let secret = secret(&bytes).ok_or_else(|| refused(shape))?;
    if is_weak(&secret) { Err(weak()) } else { Ok(Key::from_secret(&secret)) }
}

#[cfg(unix)]
fn refused_mode(metadata: &std::fs::Metadata) -> Option<u32> {
    use std::os::unix::fs::PermissionsExt;
    let mode = metadata.permissions().mode() & 0o7777;
    (mode & REFUSED_MODE != 0).then_some(mode)
}

#[cfg(not(unix))]
fn refused_mode(_: &std::fs::Metadata) -> Option<u32> {
    None
}

/// Writes a new file that only its owner can read. One that already exists is left alone.
///
/// # Errors
/// If it is there, or cannot be written.
pub fn create_key_file(path: &Path, text: &str) -> Result<(), Error> {
    let failed = |source| Error::Io { what: format!("the key {}", path.display()), source };
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path).map_err(failed)?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)
}

/// A group's file with this secret, which should come from a good random source.
#[must_use]
pub fn group_text(secret: &[u8; 32]) -> Zeroizing<String> {
    Zeroizing::new(hex(secret) + "\n")
}

/// A robot's file; `None` for a key that holds the group's secret.
#[must_use]
pub fn robot_text(key: &Key) -> Option<Zeroizing<String>> {
    let (own, group, peers) = key.robot_keys()?;
    let mut text = Zeroizing::new(format!("{ROBOT}\nrobot {own} {}\n", hex(&group)));
    for (mac, key) in peers {
        let _ = writeln!(text, "{mac} {}", hex(key));
    }
    Some(text)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len() + 1), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn unhex(digits: &str) -> Option<Zeroizing<Vec<u8>>> {
    let pairs = digits.as_bytes().chunks(2);
    let byte = |pair: &[u8]| match pair {
        [a, b] => Some((char::from(*a).to_digit(16)? * 16 + char::from(*b).to_digit(16)?) as u8),
        _ => None,
    };
    pairs.map(byte).collect::<Option<Vec<u8>>>().map(Zeroizing::new)
}

/// The secret in a group's file.
fn secret(bytes: &[u8]) -> Option<Zeroizing<Vec<u8>>> {
    let right = |secret: &Zeroizing<Vec<u8>>| [16, 32].contains(&secret.len());
    let digits = std::str::from_utf8(bytes).ok().map(str::trim).and_then(unhex).filter(right);
    digits.or_else(|| Some(Zeroizing::new(bytes.to_vec())).filter(right))
}

/// What a robot's file holds.
struct RobotKeys {
    own: Mac,
    group: Zeroizing<[u8; 16]>,
    peers: Vec<(Mac, Zeroizing<[u8; 16]>)>,
}

impl RobotKeys {
    /// `None` for another file, and for one that names a peer twice.
    fn parse(bytes: &[u8]) -> Option<Self> {
        let mut lines = std::str::from_utf8(bytes).ok()?.lines();
        (lines.next()? == ROBOT).then_some(())?;
        let own = lines.next()?.strip_prefix("robot ")?;
        let entry = |line: &str| -> Option<(Mac, Zeroizing<[u8; 16]>)> {
            let (mac, digits) = line.split_once(' ')?;
            Some((mac.parse().ok()?, Zeroizing::new(unhex(digits)?.as_slice().try_into().ok()?)))
        };
        let (own, group) = entry(own)?;
        let peers = lines.map(entry).collect::<Option<Vec<_>>>()?;
        let named: BTreeSet<Mac> = peers.iter().map(|(mac, _)| *mac).collect();
        (named.len() == peers.len() && !named.contains(&own)).then_some(Self { own, group, peers })
    }

    /// The keys, unless one can be guessed.
    fn key(&self) -> Option<Key> {
        let mut all = std::iter::once(&self.group).chain(self.peers.iter().map(|(_, key)| key));
        // The text check applies to the secret only: among many derived keys some may look like text.
        let is_guessed = all.any(|key| is_patterned(key.as_slice()));
        let peers = self.peers.iter().map(|(mac, key)| (*mac, **key)).collect();
        (!is_guessed).then(|| Key::of_robot(self.own, *self.group, peers))
    }
}

/// True for what no random source gives: each rule refuses less than one in a hundred thousand random secrets.
fn is_weak(secret: &[u8]) -> bool {
    // UTF-8 of any alphabet, and with the end of a line, as an editor writes it. Of other encodings nothing is known.
    let is_text = std::str::from_utf8(secret)
        .is_ok_and(|text| text.chars().all(|letter| !letter.is_control() || letter.is_whitespace()));
    is_text || is_patterned(secret)
}

/// True for repetitions and sequences.
fn is_patterned(secret: &[u8]) -> bool {
    let different = secret.iter().collect::<BTreeSet<_>>().len();
    let steps = secret.windows(2).map(|pair| pair[1].wrapping_sub(pair[0])).collect::<BTreeSet<_>>().len();
    different < secret.len() / 2 + 2 || steps < secret.len() / 2 + 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngCore, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::path::PathBuf;

    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("csi5300-key-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&folder).unwrap();
            Self(folder)
        }

        fn file(&self, name: &str, bytes: &[u8], mode: u32) -> PathBuf {
            use std::os::unix::fs::PermissionsExt;
            let path = self.0.join(name);
            std::fs::write(&path, bytes).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            path
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    const DIGITS: &str = "3f7c1e9a5b2d8046c1e0f4a7936bd258";

    #[test]
    fn a_key_is_read_in_every_form_and_nothing_else_is() {
        let folder = Folder::new("forms");
        let bytes = unhex(DIGITS).unwrap();
        let key = Key::from_secret(&bytes);
        for (name, content) in [("hex", DIGITS.as_bytes()), ("raw", bytes.as_slice())] {
            assert_eq!(read_key(&folder.file(name, content, 0o600)).unwrap(), key);
        }
        assert_eq!(read_key(&folder.file("line", format!("{DIGITS}\n").as_bytes(), 0o400)).unwrap(), key);
        let long = format!("{DIGITS}{}", "a91d4c7702fe63b8508e9fd2c4113b7a");
        assert_ne!(read_key(&folder.file("long", long.as_bytes(), 0o600)).unwrap(), key, "no byte is left out");
        for wrong in ["", "12", &DIGITS[1..], &format!("{DIGITS}00"), &format!("{long}00")] {
            let error = read_key(&folder.file("wrong", wrong.as_bytes(), 0o600)).unwrap_err();
            assert!(error.to_string().contains("a key is"), "{wrong}: {error}");
        }
        for weak in [
            "00000000000000000000000000000000",
            "000102030405060708090a0b0c0d0e0f",
            "correct horse ba",
            "+f7c1e9a5b2d8046c1e0f4a7936bd258",
            "0123456789abcdef",
            "my robot pass 7\n",
            "my\trobotpasswd42",
            "swordfish-1234567-mellon-frodo9\n",
            "Zürich-Straße1",
            "пароль-р\n",
        ] {
            let error = read_key(&folder.file("weak", weak.as_bytes(), 0o600)).unwrap_err();
            assert!(error.to_string().contains("can be guessed"), "{weak}: {error}");
        }
        assert!(matches!(read_key(Path::new("/dev/zero")).unwrap_err(), Error::NotAFile { .. }));
        assert!(matches!(read_key(&folder.0.join("none")).unwrap_err(), Error::Io { .. }));
    }

    #[test]
    fn a_key_that_others_can_read_is_refused() {
        let folder = Folder::new("modes");
        for mode in [0o644, 0o604, 0o602, 0o620, 0o666, 0o601] {
            let error = read_key(&folder.file("key", DIGITS.as_bytes(), mode)).unwrap_err();
            assert!(error.to_string().contains(&format!("has mode {mode:04o}")), "{mode:o}: {error}");
        }
        for mode in [0o600, 0o400, 0o440] {
            read_key(&folder.file("key", DIGITS.as_bytes(), mode)).unwrap();
        }
    }

    #[test]
    fn a_new_key_is_its_owners_and_overwrites_nothing() {
        use std::os::unix::fs::PermissionsExt;
        let folder = Folder::new("new");
        let (path, mut secret, mut random) = (folder.0.join("group"), [0; 32], ChaCha8Rng::seed_from_u64(1));
        random.fill_bytes(&mut secret);
        create_key_file(&path, &group_text(&secret)).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(read_key(&path).unwrap(), Key::from_secret(&secret));
        assert!(matches!(create_key_file(&path, "other").unwrap_err(), Error::Io { .. }));
        assert_eq!(read_key(&path).unwrap(), Key::from_secret(&secret));
    }

    #[test]
    fn random_secrets_are_not_refused() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for len in [16, 32] {
            for _ in 0..100_000 {
                let mut secret = vec![0; len];
                random.fill_bytes(&mut secret);
                assert!(!is_weak(&secret), "{secret:02x?}");
            }
        }
    }

    #[test]
    fn a_secret_needs_ten_bytes_and_nine_steps_that_differ_of_sixteen() {
        for (digits, different, steps, weak) in [
            ("da2ee5d02ee5c5abfd00fcc5c5e5d0b0", 10, 12, false),
            ("c18b8b621c62ffff086277c18b3fd8d8", 9, 12, true),
            ("17e9bfd6dbd142c1b7bce6e6e6bce610", 12, 9, false),
            ("f0861c68ffa55ff6a74dfe94a5f6a74d", 12, 8, true),
        ] {
            let secret = unhex(digits).unwrap();
            assert_eq!(secret.iter().collect::<BTreeSet<_>>().len(), different);
            let step = |pair: &[u8]| (256 + u16::from(pair[1]) - u16::from(pair[0])) % 256;
            assert_eq!(secret.windows(2).map(step).collect::<BTreeSet<_>>().len(), steps);
            assert_eq!(is_weak(&secret), weak, "{digits}");
        }
    }

    #[test]
    fn a_robots_file_holds_its_own_keys() {
        let folder = Folder::new("robot");
        let mac = |last| Mac([2, 0, 0, 0, 0, last]);
        let robot = Key::from_secret(&unhex(DIGITS).unwrap()).for_robot(mac(1), &[mac(2), mac(3)]);
        let text = robot_text(&robot).unwrap();
        assert_eq!(text.lines().count(), 4);
        let path = folder.file("robot", text.as_bytes(), 0o600);
        assert_eq!(read_key(&path).unwrap(), robot);
        let cut = text.trim_end().trim_end_matches(|c: char| c.is_ascii_hexdigit());
        let says = |text: &str, what: &str| {
            let error = read_key(&folder.file("refused", text.as_bytes(), 0o600)).unwrap_err();
            assert!(error.to_string().contains(what), "{error}");
        };
        says(cut, "a key is");
        assert!(robot_text(&Key::new([1; 16])).is_none());
        // A key that can be guessed, a peer with two keys, and one with itself.
        let last = text.lines().last().unwrap();
        let guessed = text.replace(last.split(' ').next_back().unwrap(), &"0".repeat(32));
        says(&guessed, "can be guessed");
        says(&format!("{}{last}\n", *text), "a key is");
        says(&text.replace(&mac(2).to_string(), &mac(1).to_string()), "a key is");
    }
}
