use super::*;

#[test]
fn each_kind_is_told_by_its_columns() {
    let five = b"10.5,0,1,2,3,\n10.6,0,1.1,2,3,\n";
    let six = b"10.5,0,1,2,3,0.5,\n10.6,0,1.1,2,3,0.6,\n";
    let nine = b"10.5,0,1,2,3,0,0,0,1\n10.6,0,1.1,2,3,0,0,0.38268343236509,0.923879532511287\n";
    let fifteen = b"10,500000000,1,2,3,0,0,0,1,0,0,0,0,0,0,\n10,600000000,1.1,2,3,0,0,0,1,0,0,0,0,0,0,\n";
    for (bytes, heading) in
        [(&five[..], None), (six, Some(0.6)), (nine, Some(std::f64::consts::FRAC_PI_4)), (fifteen, Some(0.0))]
    {
        let (trajectory, counts) = parse(bytes).unwrap();
        let last = trajectory.poses()[1];
        assert_eq!(counts.rows, 2);
        assert!((last.t_s - 10.6).abs() < 1e-9 && (last.position_m.x - 1.1).abs() < 1e-12);
        match (last.heading_rad, heading) {
            (None, None) => {}
            (Some(a), Some(b)) => assert!((a - b).abs() < 1e-8, "{a} {b}"),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn columns_may_be_parted_otherwise_and_then_have_decimal_commas() {
    let rows = "10.5,0,1.25,-2e-3,3\n10.75,0,1.5,2,3\n";
    let expected = parse(rows.as_bytes()).unwrap();
    assert_eq!((expected.1.rows, expected.1.headings), (2, false));
    let decimal_commas = |by: &str| rows.replace(',', by).replace('.', ",");
    let spaces = format!("  {}", rows.replace(',', "   ").replace('\n', "  \n "));
    for text in [rows.replace(',', ";"), rows.replace(',', "\t"), spaces, decimal_commas(";"), decimal_commas("\t")] {
        assert_eq!(parse(text.as_bytes()).unwrap(), expected, "{text}");
    }
    for headings in ["\u{feff}t;0;x;y;z\n", "# seconds\n\nZeit;ns;x;y;z\n", "\"t\";\"0\";\"x\";\"y\";\"z\"\r\n"] {
        let (trajectory, counts) = parse(format!("{headings}{}", decimal_commas(";")).as_bytes()).unwrap();
        assert_eq!((&trajectory, counts.headings, counts.bad_rows), (&expected.0, true, 0), "{headings}");
    }
    // A first row of what is no number names nothing, and only the first line does.
    for text in [format!("nan,0,1,2,3\n{rows}"), format!("a,0,x,y,z\nb,0,x,y,z\n{rows}")] {
        let (trajectory, counts) = parse(text.as_bytes()).unwrap();
        assert!(counts.bad_rows == 1 && counts.lost_something(&trajectory), "{counts:?}");
    }
}

#[test]
fn the_format_of_tum_is_told_by_its_columns() {
    let text =
        b"# timestamp tx ty tz qx qy qz qw\n10.5 1 2 3 0 0 0 1\n10.75 1.5 2 3 0 0 0.38268343236509 0.923879532511287\n";
    let (trajectory, counts) = parse(text).unwrap();
    assert_eq!((counts.columns, counts.rows, counts.bad_rows, counts.headings), (8, 2, 0, false));
    let last = trajectory.poses()[1];
    assert_eq!((last.t_s, last.position_m), (10.75, Vector3::new(1.5, 2.0, 3.0)));
    assert!((last.heading_rad.unwrap() - std::f64::consts::FRAC_PI_4).abs() < 1e-8);
    // Numbers with decimal commas, parted by commas, are as many as those of another kind.
    assert_eq!(parse_line(b"10,5,0,1,25,0,002,3,5"), Err(RowError::Quaternion));
}

#[test]
fn what_of_a_file_is_not_used_is_said() {
    let said = |text: &str| {
        let (trajectory, counts) = parse(text.as_bytes()).unwrap();
        (counts.notes(&trajectory).join("; "), counts.lost_something(&trajectory))
    };
    assert_eq!(said("1,0,0,0,0\n2,0,1,0,0\n"), (String::new(), false));
    assert_eq!(
        said("t,0,x,y,z\n2,0,1,0,0\n1,0,0,0,0\n3,0,2,0,0\n"),
        ("1 rows out of order in time, sorted".into(), false)
    );
    let (words, lost) = said("1,0,0,0,0\n1,0,1,0,0\n2,0,1,0,0\n2,0,1,0,0\n3,0,?,0,0\n");
    assert!(
        lost && words.starts_with("1 rows left out, the first in line 5: column 3 is not")
            && words.contains("; 1 rows left out at whose time"),
        "{words}"
    );
    let row = |k: u32| format!("{},0,{},0,0\n", if k < 60 { k } else { k - 30 }, f64::from(k) * 0.1);
    let (words, lost) = said(&(0..100).map(row).collect::<String>());
    assert!(lost && words.starts_with("time goes back by 29.000 s") && words.contains(" 40 rows left out"), "{words}");
}

#[test]
fn bad_rows_are_counted_and_the_rest_is_used() {
    let text = b"1,0,0,0,0,\nnonsense\n2,0,1,0,0,\n3,0,nan,0,0,\n2.5,0,1,0,0,\n";
    let (trajectory, counts) = parse(text).unwrap();
    assert_eq!((trajectory.poses().len(), counts.bad_rows, counts.out_of_order), (3, 2, 0));
    assert_eq!(counts.first_bad.unwrap().0, 2);
}

#[test]
fn a_stray_quote_costs_its_row_and_quoted_numbers_are_numbers() {
    let mut text = String::new();
    (0..100).for_each(|k| text += &format!("{k},0,\"{k}\",0,{}0,\n", if k == 10 { "\"1" } else { "" }));
    let (trajectory, counts) = parse(text.as_bytes()).unwrap();
    assert_eq!((trajectory.poses().len(), counts.rows, counts.bad_rows), (100, 100, 0), "a quote at an end is none");
    let text = text.replace("\"10\"", "1\"0");
    let (trajectory, counts) = parse(text.as_bytes()).unwrap();
    assert_eq!((trajectory.poses().len(), counts.bad_rows), (99, 1));
    assert_eq!(counts.first_bad, Some((11, RowError::Number(3))));
}

#[test]
fn coordinates_of_which_no_metre_is_left_are_none() {
    for (far, expected) in [(1e9, Ok(())), (-1.000_001e9, Err(())), (1e308, Err(()))] {
        for column in 2..5 {
            let mut cells = ["1", "0", "0", "0", "0"].map(str::to_owned);
            cells[column] = far.to_string();
            let parsed = parse_line(cells.join(",").as_bytes());
            let expected = expected.map_err(|()| RowError::TooFar(column + 1));
            assert_eq!(parsed.map(|_| ()), expected, "{far} in {column}");
        }
    }
}

#[test]
fn rows_that_are_written_are_read_again() {
    for heading_rad in [None, Some(-0.5)] {
        let pose = Pose { t_s: 1_700_000_000.25, position_m: Vector3::new(1.0, -2.5, 0.125), heading_rad };
        assert_eq!(parse_line(line(&pose).as_bytes()), Ok(pose));
    }
    assert!(parse_line(b"").is_err() && parse_line(b"1,2,3").is_err() && parse_line(b"1,0,a,0,0").is_err());
}

#[test]
fn what_reading_holds_is_the_poses_and_not_the_file() {
    const ROWS: usize = 20_000;
    let path = std::env::temp_dir().join(format!("csi5300-rows-{}.csv", std::process::id()));
    let row = |k: usize| format!("{k},0,{k}.125,2.25,3.5,0,0,0,1,{}0\n", "0.000000000000000000000,".repeat(5));
    std::fs::write(&path, (0..ROWS).map(row).collect::<String>()).unwrap();
    let length = std::fs::metadata(&path).unwrap().len();
    let mut read = None;
    let held = allocation_counter::measure(|| read = Some(super::read(&path))).bytes_max;
    std::fs::remove_file(&path).unwrap();
    let poses = (ROWS * size_of::<Pose>()) as u64;
    assert_eq!(read.unwrap().unwrap().1.rows, ROWS as u64);
    // Poses that move into a place a quarter larger are there twice for that moment.
    assert!(held < 9 * poses / 4 && held < length, "{held} bytes for {poses} of poses, {length} of the file");
}

#[test]
fn there_is_a_most_of_poses() {
    let rows = |most| {
        let mut rows = Rows::default();
        let end = rows.read(&b"1,0,0,0,0\n2,0,0,0,0\n3,0,0,0,0\n"[..], most).unwrap();
        (matches!(end, End::TooMany), rows.poses.len())
    };
    assert_eq!([rows(2), rows(3)], [(true, 2), (false, 3)]);
}

#[test]
fn a_row_without_an_end_takes_no_memory_and_costs_itself() {
    let (before, after) = (&b"1,0,0,0,0\n"[..], &b"\n2,0,0,0,0\n"[..]);
    let zeros = std::io::repeat(0).take(64 << 20);
    let mut rows = Rows::default();
    let held = allocation_counter::measure(|| {
        assert!(matches!(rows.read(before.chain(zeros).chain(after), 9), Ok(End::Whole)));
    });
    assert!(held.bytes_max < 1 << 20, "{} bytes", held.bytes_max);
    assert_eq!((rows.poses.len(), rows.counts.bad_rows, rows.counts.first_bad.unwrap().0), (2, 1, 2));
}

#[test]
fn wrong_files_say_what_is_wrong() {
    assert!(matches!(parse(b""), Err(CsvError::Empty { first: None })));
    assert!(matches!(parse(b"a,b,c\n"), Err(CsvError::Columns { line: 1, found: 3 })));
    assert!(matches!(parse(&[0xBB, 0, 0xFF, b'\n', 7]), Err(CsvError::Empty { first: Some(_) })));
    assert!(matches!(parse(b"1,0,0,0,0\n"), Err(CsvError::Trajectory(TrajectoryError::TooFew { poses: 1 }))));
}
