//! The node: its link, its clock, the topics of poses that it reads, and what it publishes for a robot.

use crate::bag::Bag;
use crate::inputs::{DEPTH, SimClock, poses};
use crate::link::{Came, Link, Publisher, usual};
use crate::names::{Names, name_part};
use crate::rtps::Qos;
use crate::said;
use crate::settings::{Asked, Reach, Settings, Topic, outward};
use crate::sockets::Sockets;
use csi5300::motion::odometry::ros::Stamp;
use csi5300::pipeline::live::PeerReport;
use csi5300::source::survey::Survey;
use csi5300::source::{Error, Next};
use csi5300_bag::messages::{
    Bearing, Csi, GetParametersRequest, GetParametersResponse, Header, ListParametersRequest, ListParametersResponse,
    ListParametersResult, MarkerArray, ParameterValue, PoseStamped, PoseWithCovarianceStamped, Range, TfMessage, Time,
    TriggerRequest, TriggerResponse,
};
use std::path::PathBuf;
use std::sync::Arc;

/// Publishers of one peer.
struct Peer {
    bearings: Publisher<Bearing>,
    directions: Publisher<PoseStamped>,
    places: Publisher<PoseWithCovarianceStamped>,
}

/// A node of ROS 2.
pub struct Node {
    /// For publishing, subscribing and serving further topics and services.
    pub link: Link,
    /// The clock of its stamps.
    clock: SimClock,
    settings: Settings,
    /// Those with published bearings.
    peers: Vec<Peer>,
    /// The topic of markers, if enabled.
    pub markers: Option<Publisher<MarkerArray>>,
    /// The topic of transforms, if enabled.
    pub tf: Option<Publisher<TfMessage>>,
}

impl Node {
    /// The node of the robot called `robot`. `wall_us` reads the host's wall clock, microseconds since the Unix epoch.
    ///
    /// # Errors
    /// If it cannot use that address, or the recording cannot start.
    pub fn start(settings: &Settings, robot: &str, wall_us: fn() -> Option<i64>) -> Result<Self, Error> {
        let asked = settings.clone();
        let (domain, own, by) = (asked.domain(), settings.clone(), Asked::by_environment());
        let seek = move || Reach::of(&own, &by, outward);
        let reach = seek();
        let what = format!("cannot take part in domain {domain} of ROS 2 at {}", reach.interface);
        let sockets = Sockets::open(domain, reach).map_err(Error::io(&what))?;
        let node = asked.node.clone().unwrap_or_else(|| name_part(&format!("csi5300_{robot}")));
        let names = Names { namespace: asked.namespace.clone(), node, remap: asked.remap.clone() };
        let bag = Bag::new(asked.bag.clone().unwrap_or_default());
        if let Some(folder) = &asked.bag {
            bag.start().map_err(Error::io(format!("cannot record to {}", folder.display())))?;
        }
        let link = Link::start((names, asked.distribution), (sockets, seek), bag, wall_us).map_err(Error::io(what))?;
        let clock = if asked.use_sim_time { SimClock::follow(&link) } else { SimClock::real() };
        Ok(Self { link, clock, settings: asked, peers: Vec::new(), markers: None, tf: None })
    }

    /// Poses of a topic, with the usual time source unless the topic names one.
    #[must_use]
    pub fn poses(&self, topic: &Topic, usual: Stamp) -> csi5300::motion::odometry::ros::Topic {
        poses(&self.link, topic, usual, &self.clock)
    }

    /// Passes the ranges of a topic (`sensor_msgs/msg/Range`) to `used`: host time in microseconds, range and its deviation in
    /// metres (0: unknown); `None` for a message that cannot be used. A range without a stamp has its time of receipt.
    pub fn ranges(&self, topic: &str, used: impl Fn(Option<(i64, [f64; 2])>) + Clone + Send + 'static) {
        let (clock, unreadable) = (self.clock.clone(), used.clone());
        let read = move |told: Range, came: Came| {
            let stamp_us = told.header.stamp.us();
            let at_us = if stamp_us == 0 { Some(came.at_us) } else { clock.to_host(stamp_us) };
            used(at_us.zip(told.metres()));
        };
        self.link.subscribe(topic, Qos::best_effort(DEPTH), read, move || unreadable(None));
    }

    /// Announces the topics of the peers of these names, as the settings ask.
    pub fn announce(&mut self, peers: &[String]) {
        let (link, asked) = (&self.link, &self.settings);
        let peer = |name: &String| {
            let part = name_part(name);
            Peer {
                bearings: link.publish(&format!("~/{part}/bearing"), usual()),
                directions: link.publish(&format!("~/{part}/direction"), usual()),
                places: link.publish(&format!("~/{part}/pose"), usual()),
            }
        };
        self.peers = if asked.publish_bearings { peers.iter().map(peer).collect() } else { Vec::new() };
        self.markers = asked.publish_markers.then(|| link.publish("~/markers", usual()));
        self.tf = asked.publish_tf.then(|| link.publish("/tf", usual()));
        if asked.bag.is_some() {
            serve_recording(link);
        }
    }

    /// The publisher of the card's records, if enabled.
    #[must_use]
    pub fn records(&self) -> Option<Records> {
        let publish = || self.link.publish("~/csi", Qos::best_effort(5));
        let csi = self.settings.publish_csi.then(publish)?;
        Some(Records { csi, clock: self.clock.clone(), survey: Survey::default() })
    }

    /// A header with the stamp of a host time, microseconds since the Unix epoch.
    #[must_use]
    pub fn header(&self, host_us: i64, frame_id: String) -> Header {
        Header { stamp: Time::from_us(self.clock.to_stamp(host_us)), frame_id }
    }

    /// Publishes the report of peer number `peer`.
    pub fn report(&self, peer: usize, report: &PeerReport) {
        let header = self.header((report.t_s.unwrap_or(0.0) * 1e6).round() as i64, self.settings.frame.clone());
        let place = said::place(&header, report);
        if let Some(peer) = self.peers.get(peer) {
            peer.bearings.put(&said::bearing(header.clone(), report));
            said::direction(&header, report).iter().for_each(|pose| peer.directions.put(pose));
            place.iter().for_each(|place| peer.places.put(place));
        }
        if let Some(markers) = &self.markers {
            markers.put(&said::markers(&header, (&report.answer.link, peer), report));
        }
        if let (Some(tf), Some(place)) = (&self.tf, &place) {
            tf.put(&said::transform(place, &name_part(&report.answer.link)));
        }
    }

    /// Serves parameters for `ros2 param get` and `list`.
    pub fn serve_parameters(&self, all: Vec<(&'static str, ParameterValue)>) {
        let all: Arc<[(&'static str, ParameterValue)]> = all.into();
        let told = Arc::clone(&all);
        self.link.serve("~/get_parameters", move |_, asked: GetParametersRequest| {
            // A parameter that does not exist is "not set": type 0.
            let value = |name: &String| told.iter().find(|(known, _)| known == name).map(|(_, value)| value.clone());
            GetParametersResponse { values: asked.names.iter().map(|name| value(name).unwrap_or_default()).collect() }
        });
        self.link.serve("~/list_parameters", move |_, asked: ListParametersRequest| {
            let is_asked =
                |name: &&str| asked.prefixes.is_empty() || asked.prefixes.iter().any(|prefix| prefix == name);
            let names = all.iter().map(|(name, _)| *name).filter(is_asked).map(str::to_owned).collect();
            ListParametersResponse { result: ListParametersResult { names, prefixes: Vec::new() } }
        });
    }

    /// Current problems as text.
    #[must_use]
    pub fn trouble(&self) -> Vec<String> {
        let clock = self.clock.is_unknown().then(|| "ROS 2: no message on /clock (`use_sim_time`)".to_owned());
        self.link.trouble().into_iter().chain(clock).collect()
    }
}

/// Starts and stops the recording while the node runs.
fn serve_recording(link: &Link) {
    let told = |done: Result<PathBuf, String>| match done {
        Ok(folder) => TriggerResponse { success: true, message: folder.display().to_string() },
        Err(message) => TriggerResponse { success: false, message },
    };
    link.serve("~/start_recording", move |shared, _: TriggerRequest| {
        told(shared.bag.start().map_err(|error| error.to_string()))
    });
    link.serve("~/stop_recording", move |shared, _: TriggerRequest| {
        told(shared.bag.stop().unwrap_or_else(|| Err("there is no recording".into())))
    });
}

/// Publishes a card's records.
pub struct Records {
    csi: Publisher<Csi>,
    clock: SimClock,
    survey: Survey,
}

impl Records {
    /// Publishes what a source gave, if it is a record with CSI.
    pub fn put(&mut self, next: &Next<'_>) {
        let Some((bfee, identity)) = self.survey.note(next) else { return };
        let stamp = Time::from_us(self.clock.to_stamp(identity.host_us.unwrap_or(0)));
        self.csi.put(&Csi::of(stamp, &bfee, identity));
    }
}
