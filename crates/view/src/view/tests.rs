use super::*;
use csi5300::pipeline::Options;
use csi5300::signal::channel::{Channel, Width};
use csi5300_lab::evaluate::TrajectorySource;
use serde_json::Value;
use std::path::PathBuf;

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures")
}

fn reading() -> Reading {
    Reading::new(TrajectorySource::GroundTruth, None, Options::new(Channel::new(108, Width::Ht20).unwrap()))
}

fn ask(view: &View, path: &str, query: &str) -> Value {
    let answer = view.answer(path, query).unwrap();
    assert_eq!(answer.kind, "application/json");
    serde_json::from_slice(&answer.bytes).unwrap()
}

#[test]
fn a_folder_answers_what_evaluate_and_the_log_say() {
    let view = View::open(&fixtures(), reading()).unwrap();
    let overview = ask(&view, "/data/overview", "");
    assert_eq!((overview["kind"].as_str(), overview["logs"].as_array().map(Vec::len)), (Some("captures"), Some(2)));
    assert_eq!(overview["links"].as_array().map(Vec::len), Some(1));
    // Until it is evaluated it is waited for.
    let waiting = ask(&view, "/data/link/0", "");
    assert_eq!((&waiting["waiting"], waiting["logs"]["receiver"].is_u64()), (&Value::from(true), true), "{waiting}");
    assert_eq!(ask(&view, "/data/rows", "")["known"], 0);
    let mut seen = Vec::new();
    view.finish(|done| seen.push(done));
    assert_eq!((seen, view.outcome()), (vec![1], (true, false)));
    let rows = ask(&view, "/data/rows", "");
    let row = &rows["rows"][0];
    assert!(row["error_from_mean_pose_deg"].as_f64().unwrap().abs() < 0.1, "{row}");
    assert_eq!(ask(&view, "/data/rows", "known=1")["rows"].as_array().map(Vec::len), Some(0));
    let sets = ask(&view, "/data/sets", "");
    assert_eq!((&sets["all"]["links"], &sets["all"]["beside"]), (&Value::from(1), &Value::Null));

    let link = ask(&view, "/data/link/0", "");
    assert_eq!(link["row"]["azimuth_deg"], row["azimuth_deg"]);
    let curve = &link["drawn"]["curves"][0];
    let values: Vec<f64> = curve["values"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
    let best = values.iter().position(|value| *value == 1.0).unwrap();
    let off = curve["azimuths_deg"][best].as_f64().unwrap() - row["azimuth_deg"].as_f64().unwrap();
    assert!(off.abs() < 1.0, "the curve's top is the answer: {off}");
    let receiver = link["logs"]["receiver"].as_u64().unwrap();
    let facts = ask(&view, &format!("/data/log/{receiver}"), "");
    assert!(facts["name"].as_str().unwrap().contains("csi_rx_"), "{facts}");
    assert_eq!(facts["senders"][0]["records"], facts["wsr"]);
}

#[test]
fn a_stretch_of_a_log_is_what_was_asked_for() {
    let view = View::open(&fixtures().join("small-circle"), reading()).unwrap();
    let log = view.logs.iter().position(|log| log.name.starts_with("csi_rx_")).unwrap();
    let whole = ask(&view, &format!("/data/log/{log}/levels"), "columns=40");
    let to_s = whole["to_s"].as_f64().unwrap();
    let part = ask(&view, &format!("/data/log/{log}/levels"), &format!("from=0.5&to={to_s}&columns=40"));
    assert_eq!((part["from_s"].as_f64(), part["rssi"][0]["mean"].as_array().map(Vec::len)), (Some(0.5), Some(40)));
    assert!(part["records"].as_u64() < whole["records"].as_u64());
    let csi = ask(&view, &format!("/data/log/{log}/csi"), "columns=40&antenna=A");
    let antennas = csi["antennas"].as_array().unwrap();
    assert_eq!((antennas.len(), antennas[0]["antenna"].as_str()), (1, Some("A")));
    let cells = antennas[0]["amplitude_db"]["cells"].as_str().unwrap();
    assert_eq!(cells.len(), (40_usize * 30).div_ceil(3) * 4);
}

#[test]
fn a_heat_map_is_of_one_sender() {
    let folder = std::env::temp_dir().join(format!("csi5300-senders-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let read = |name: &str| std::fs::read(fixtures().join("small-circle").join(name)).unwrap();
    let (rx, tx) = (read("csi_rx_2023-11-14_221320.dat"), read("csi_tx1_2023-11-14_221320.dat"));
    std::fs::write(folder.join("both.dat"), [&tx[..tx.len() / 2], &rx].concat()).unwrap();
    let view = View::open(&folder, reading()).unwrap();
    let senders = ask(&view, "/data/log/0", "")["senders"].clone();
    let most = senders.as_array().unwrap().iter().max_by_key(|sender| sender["records"].as_u64()).unwrap();
    let csi = ask(&view, "/data/log/0/csi", "columns=40");
    assert_eq!((senders.as_array().map(Vec::len), &csi["sender"]), (Some(2), &most["mac"]), "{senders}");
    assert_eq!(csi["records"], most["records"], "{senders}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_stretch_of_a_log_that_was_replaced_is_refused_until_the_page_is_loaded_again() {
    let folder = std::env::temp_dir().join(format!("csi5300-view-replaced-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let fixture = View::open(&fixtures(), reading()).unwrap().logs.iter().next().map(|log| log.path.clone()).unwrap();
    let log = folder.join("a.dat");
    std::fs::copy(&fixture, &log).unwrap();
    let view = View::open(&log, reading()).unwrap();
    ask(&view, "/data/log/0/csi", "columns=40");
    std::fs::copy(&fixture, folder.join("b")).unwrap();
    std::fs::rename(folder.join("b"), &log).unwrap();
    for what in ["csi", "levels"] {
        let error = view.answer(&format!("/data/log/0/{what}"), "").map(|_| ()).unwrap_err();
        assert!(error.status() == 409 && error.to_string().contains("was changed since"), "{what}: {error}");
    }
    ask(&view, "/data/log/0", "");
    ask(&view, "/data/log/0/csi", "columns=40");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_cannot_be_meant_is_said() {
    let view = View::open(&fixtures(), reading()).unwrap();
    for path in
        ["/data/log/9", "/data/link/7", "/data/states", "/../Cargo.toml", "/data/log/0/../1", "/data/log/-1", "//", ""]
    {
        let error = view.answer(path, "").map(|answer| answer.kind);
        assert!(path.is_empty() && error.is_ok() || error.is_err_and(|error| error.status() == 404), "{path}");
    }
    for query in ["columns=many", "from=x", "sender=nobody"] {
        let error = view.answer("/data/log/0/levels", query).map(|_| ()).unwrap_err();
        assert_eq!(error.status(), 400, "{query}: {error}");
    }
    let endless = ask(&view, "/data/log/0/levels", "columns=99999999&from=nan&to=inf");
    assert!(endless["columns"].as_u64() <= Some(4_000), "{}", endless["columns"]);
    assert!(matches!(View::open(Path::new("/nowhere"), reading()), Err(Error::Missing { .. })));
    let toml = fixtures().join("small-circle.toml");
    assert!(matches!(View::open(&toml, reading()), Err(Error::NoRecord { .. })));
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    assert!(matches!(View::open(&source, reading()), Err(Error::Empty { .. })));
}

#[test]
fn the_page_as_one_file_has_all_its_answers_and_fetches_nothing() {
    let view = View::open(&fixtures(), reading()).unwrap();
    view.finish(|_| {});
    let page = view.file().unwrap();
    assert!(page.len() < 400 * 1024, "{} KiB", page.len() / 1024);
    for outside in ["src=\"", "href=\"http", "@import", "url(http"] {
        assert!(!page.contains(outside), "{outside}");
    }
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"answers\">").unwrap();
    let answers: Value = serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap();
    for path in ["/data/overview", "/data/rows", "/data/sets", "/data/link/0", "/data/log/1/levels", "/data/log/0/csi"]
    {
        assert!(answers.get(path).is_some(), "{path}");
    }
    assert_eq!(answers["/data/rows"], ask(&view, "/data/rows", ""));
}
