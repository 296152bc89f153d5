// fastdds DOMAIN HOW: a ROS 2 program over Fast DDS, with the settings of rmw_fastrtps. It publishes the poses of three robots, reads
// the topics of tb3_0's node, calls services, and prints what it receives as JSON lines. HOW is
//   default    nothing is set: UDP with multicast, and shared memory
//   localhost  as ROS_LOCALHOST_ONLY=1 (Humble): UDP on 127.0.0.1 only, and shared memory
//   range      as ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST (from Iron on): no multicast, peers of this machine
// Standard input: `call NAME` calls a service (std_srvs/srv/Trigger), `greedy` requests reliable CSI, `modest` no longer does.
#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <functional>
#include <iostream>
#include <mutex>
#include <sstream>
#include <thread>

using namespace eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastcdr::Cdr;

// Values in the order of the .msg files; `each` passes them to the reader or writer.
template <bool READS> struct Archive {
    Cdr& cdr;
    template <class... V> void operator()(V&... values) { (one(values), ...); }
    template <class V> void one(V& value) {
        if constexpr (std::is_arithmetic_v<V> || std::is_same_v<V, std::string>) {
            if constexpr (READS) cdr >> value;
            else cdr << value;
        } else value.each(*this);
    }
    template <class V> void one(std::vector<V>& values) {
        uint32_t count = values.size();
        one(count);
        if (READS) values.resize(count);
        for (auto& value : values) one(value);
    }
    template <class V, size_t N> void one(std::array<V, N>& values) { for (auto& value : values) one(value); }
};
#define FIELDS(...) template <class A> void each(A& archive) { archive(__VA_ARGS__); }

struct Time { int32_t sec = 0; uint32_t nanosec = 0; FIELDS(sec, nanosec) };
struct Header { Time stamp; std::string frame_id; FIELDS(stamp, frame_id) };
struct Vector3 { double x = 0, y = 0, z = 0; FIELDS(x, y, z) };
struct Quaternion { double x = 0, y = 0, z = 0, w = 1; FIELDS(x, y, z, w) };
struct Pose { Vector3 position; Quaternion orientation; FIELDS(position, orientation) };
struct PoseStamped { Header header; Pose pose; FIELDS(header, pose) };
struct Odometry {
    Header header; std::string child_frame_id; Pose pose; std::array<double, 36> pose_covariance{}; Vector3 linear, angular;
    std::array<double, 36> twist_covariance{};
    FIELDS(header, child_frame_id, pose, pose_covariance, linear, angular, twist_covariance)
};
struct Colour { float r, g, b, a; FIELDS(r, g, b, a) };
struct Duration { int32_t sec; uint32_t nanosec; FIELDS(sec, nanosec) };
struct Picture { Header header; std::string format; std::vector<uint8_t> data; FIELDS(header, format, data) };
struct Texture { float u, v; FIELDS(u, v) };
struct Mesh { std::string filename; std::vector<uint8_t> data; FIELDS(filename, data) };
struct Marker {
    Header header; std::string ns; int32_t id, type, action; Pose pose; Vector3 scale; Colour colour; Duration lifetime; bool frame_locked;
    std::vector<Vector3> points; std::vector<Colour> colours; std::string texture_resource; Picture texture; std::vector<Texture> uv;
    std::string text, mesh_resource; Mesh mesh_file; bool use_materials;
    FIELDS(header, ns, id, type, action, pose, scale, colour, lifetime, frame_locked, points, colours, texture_resource, texture, uv, text,
           mesh_resource, mesh_file, use_materials)
};
struct MarkerArray { std::vector<Marker> markers; FIELDS(markers) };
struct KeyValue { std::string key, value; FIELDS(key, value) };
struct Status { uint8_t level; std::string name, message, hardware_id; std::vector<KeyValue> values; FIELDS(level, name, message, hardware_id, values) };
struct DiagnosticArray { Header header; std::vector<Status> status; FIELDS(header, status) };
struct Bearing {
    Header header; std::string peer, mac, state, words; double azimuth; std::array<double, 12> others; uint32_t pairs;
    FIELDS(header, peer, mac, state, words, azimuth, others, pairs)
};
struct Csi {
    Header header; std::string mac; uint32_t frame_count, timestamp_low; uint16_t bfee_count; uint8_t n_rx, n_tx; std::array<uint8_t, 3> rssi;
    int8_t noise; uint8_t agc; uint16_t rate_n_flags; std::vector<uint8_t> antennas; std::vector<int8_t> re, im;
    FIELDS(header, mac, frame_count, timestamp_low, bfee_count, n_rx, n_tx, rssi, noise, agc, rate_n_flags, antennas, re, im)
};
struct TransformStamped { Header header; std::string child; Vector3 translation; Quaternion rotation; FIELDS(header, child, translation, rotation) };
struct TFMessage { std::vector<TransformStamped> transforms; FIELDS(transforms) };
struct Gid { std::array<uint8_t, 16> data; FIELDS(data) };
struct Node { std::string space, name; std::vector<Gid> readers, writers; FIELDS(space, name, readers, writers) };
struct Graph { Gid gid; std::vector<Node> nodes; FIELDS(gid, nodes) };
struct Request { uint8_t none = 0; FIELDS(none) };
struct Response { bool success = false; std::string message; FIELDS(success, message) };

// Largest message, bytes: those in fragments are larger than a datagram.
constexpr uint32_t LARGEST = 400000;

template <class T> struct Type : TopicDataType {
    explicit Type(const std::string& name, uint32_t size) { setName(name.c_str()); m_typeSize = size; m_isGetKeyDefined = false; }
    bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
        eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        payload->encapsulation = CDR_LE;
        cdr.serialize_encapsulation();
        Archive<false> archive{cdr};
        archive(*static_cast<T*>(data));
        payload->length = cdr.getSerializedDataLength();
        return true;
    }
    bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
        try {
            eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
            Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
            cdr.read_encapsulation();
            Archive<true> archive{cdr};
            archive(*static_cast<T*>(data));
            return true;
        } catch (const std::exception& error) {
            std::cerr << getName() << ": " << error.what() << std::endl;
            return false;
        }
    }
    std::function<uint32_t()> getSerializedSizeProvider(void*) override { return [this] { return m_typeSize; }; }
    void* createData() override { return new T; }
    void deleteData(void* data) override { delete static_cast<T*>(data); }
    bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

DomainParticipant* participant;
Publisher* publisher;
Subscriber* subscriber;

template <class T> Topic* topic(const std::string& name, const std::string& type, uint32_t size = 8192) {
    if (participant->find_type(type).empty()) TypeSupport(new Type<T>(type, size)).register_type(participant);
    auto* known = participant->lookup_topicdescription(name);
    return known ? dynamic_cast<Topic*>(known) : participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
}

std::string in_dds(const std::string& package, const std::string& kind, const std::string& part = "msg") {
    return package + "::" + part + "::dds_::" + kind + "_";
}

template <class T> DataWriter* writer(const std::string& name, const std::string& type, bool reliable, uint32_t size = 8192) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    qos.history().depth = 10;
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
    if (size > 65000) qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
    return publisher->create_datawriter(topic<T>(name, type, size), qos);
}

template <class T> DataReader* reader(const std::string& name, const std::string& type, bool reliable, bool latched = false) {
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    if (latched) qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
    qos.history().depth = 50;
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
    return subscriber->create_datareader(topic<T>(name, type), qos);
}

template <class T> void each(DataReader* from, const std::function<void(T&, SampleInfo&)>& used) {
    T value;
    SampleInfo info;
    while (from && from->take_next_sample(&value, &info) == ReturnCode_t::RETCODE_OK) {
        if (info.valid_data) used(value, info);
        value = T();
    }
}

std::string quoted(const std::string& text) {
    std::string out = "\"";
    for (char c : text) out += c == '"' || c == '\\' ? std::string("\\") + c : c == '\n' ? "\\n" : std::string(1, c);
    return out + "\"";
}

// A client as in rmw_fastrtps: its answers carry the identity of its reader and the number of the request.
struct Client {
    DataWriter* asks;
    DataReader* hears;
    explicit Client(const std::string& name)
        : asks(writer<Request>("rq" + name + "Request", in_dds("std_srvs", "Trigger_Request", "srv"), true)),
          hears(reader<Response>("rr" + name + "Reply", in_dds("std_srvs", "Trigger_Response", "srv"), true)) {}
};

DomainParticipant* join(int domain, const std::string& how) {
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    qos.name("fastdds");
    if (how != "default") {
        auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
        if (how == "localhost") udp->interfaceWhiteList.emplace_back("127.0.0.1");
        else {
            udp->maxInitialPeersRange = 32;
            rtps::Locator_t none, peer;
            qos.wire_protocol().builtin.metatrafficUnicastLocatorList.push_back(none);
            rtps::IPLocator::setIPv4(peer, 127, 0, 0, 1);
            qos.wire_protocol().builtin.initialPeersList.push_back(peer);
        }
        qos.transport().use_builtin_transports = false;
        qos.transport().user_transports = {udp, std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>()};
    }
    return DomainParticipantFactory::get_instance()->create_participant(domain, qos);
}

Pose stand(double x, double y, double heading) {
    Pose pose;
    pose.position.x = x, pose.position.y = y;
    pose.orientation.z = std::sin(heading / 2), pose.orientation.w = std::cos(heading / 2);
    return pose;
}

// Two robots on circles and a stationary one, as in robots.py.
struct Robots {
    DataWriter* odometry[2];
    DataWriter* pose;
    std::string long_name = "world" + std::string(150000, '_');
    int turn = 0;
    Robots()
        : odometry{writer<Odometry>("rt/tb3_0/odom", in_dds("nav_msgs", "Odometry"), true),
                   writer<Odometry>("rt/tb3_1/odom", in_dds("nav_msgs", "Odometry"), false)},
          pose(writer<PoseStamped>("rt/tb3_2/pose", in_dds("geometry_msgs", "PoseStamped"), true, LARGEST)) {}
    void publish() {
        double now = std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
        const double circles[2][4] = {{0, 0, 0.3, 0.7}, {24, 10, 0.25, -0.4}};
        for (int k = 0; k < 2; k++) {
            auto [x, y, radius, rate] = circles[k];
            double angle = std::fmod(rate * now, 2 * M_PI);
            Odometry said;
            said.header.stamp.sec = std::floor(now), said.header.stamp.nanosec = std::fmod(now, 1.0) * 1e9;
            said.header.frame_id = "odom", said.child_frame_id = k ? "tb3_1/base_footprint" : "tb3_0/base_footprint";
            said.pose = stand(x + radius * std::cos(angle), y + radius * std::sin(angle), angle + std::copysign(M_PI / 2, rate));
            odometry[k]->write(&said);
        }
        // So long that it is sent in fragments.
        PoseStamped said;
        said.header.frame_id = long_name;
        said.pose = stand(-14, 16, 0.3);
        if (turn++ % 5 == 0) pose->write(&said);
    }
};

std::mutex lines_lock;
std::vector<std::string> lines;
std::atomic<bool> over{false};

void listen() {
    for (std::string line; std::getline(std::cin, line);) {
        std::lock_guard<std::mutex> guard(lines_lock);
        lines.push_back(line);
    }
    over = true;
}

int main(int, char** words) {
    participant = join(std::stoi(words[1]), words[2]);
    if (!participant) return 1;
    publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    const std::string node = "/csi5300_tb3_0";
    Robots robots;
    DataReader* bearings[2] = {reader<Bearing>("rt" + node + "/tb3_1/bearing", in_dds("csi5300_msgs", "Bearing"), true),
                               reader<Bearing>("rt" + node + "/tb3_2/bearing", in_dds("csi5300_msgs", "Bearing"), true)};
    auto* markers = reader<MarkerArray>("rt" + node + "/markers", in_dds("visualization_msgs", "MarkerArray"), true);
    auto* directions = reader<PoseStamped>("rt" + node + "/tb3_1/direction", in_dds("geometry_msgs", "PoseStamped"), true);
    auto* diagnostics = reader<DiagnosticArray>("rt/diagnostics", in_dds("diagnostic_msgs", "DiagnosticArray"), true);
    auto* csi = reader<Csi>("rt" + node + "/csi", in_dds("csi5300_msgs", "Csi"), false);
    auto* graph = reader<Graph>("ros_discovery_info", in_dds("rmw_dds_common", "ParticipantEntitiesInfo"), true, true);
    Client start(node + "/start_recording"), stop(node + "/stop_recording");
    DataReader* greedy = nullptr;
    std::thread(listen).detach();
    uint64_t records = 0;
    while (!over) {
        robots.publish();
        for (auto* from : bearings)
            each<Bearing>(from, [](Bearing& b, SampleInfo&) {
                std::cout << "{\"bearing\": " << quoted(b.peer) << ", \"state\": " << quoted(b.state) << ", \"frame\": " << quoted(b.header.frame_id)
                          << ", \"azimuth\": " << (std::isfinite(b.azimuth) ? std::to_string(b.azimuth) : "null") << "}\n";
            });
        each<MarkerArray>(markers, [](MarkerArray& array, SampleInfo&) {
            for (auto& m : array.markers)
                if (m.type == 0 && m.action == 0 && m.points.size() == 2)
                    std::cout << "{\"arrow\": " << quoted(m.ns) << ", \"of\": " << array.markers.size() << ", \"azimuth\": "
                              << std::atan2(m.points[1].y - m.points[0].y, m.points[1].x - m.points[0].x) << "}\n";
        });
        each<PoseStamped>(directions, [](PoseStamped& p, SampleInfo&) {
            std::cout << "{\"direction\": " << 2 * std::atan2(p.pose.orientation.z, p.pose.orientation.w) << "}\n";
        });
        each<DiagnosticArray>(diagnostics, [](DiagnosticArray& array, SampleInfo&) {
            std::cout << "{\"diagnostics\": [";
            for (size_t k = 0; k < array.status.size(); k++) std::cout << (k ? ", " : "") << quoted(array.status[k].name);
            std::cout << "]}\n";
        });
        each<Csi>(csi, [&](Csi& c, SampleInfo&) {
            if (c.re.size() == size_t(30) * c.n_rx * c.n_tx && c.im.size() == c.re.size() && !c.mac.empty()) records++;
            if (records % 100 == 1) std::cout << "{\"csi\": " << records << "}\n";
        });
        each<Graph>(graph, [](Graph& g, SampleInfo&) {
            for (auto& n : g.nodes) std::cout << "{\"node\": " << quoted(n.space + n.name) << ", \"writers\": " << n.writers.size() << "}\n";
        });
        for (Client* client : {&start, &stop})
            each<Response>(client->hears, [&](Response& r, SampleInfo& info) {
                // For this client: all answers share one topic.
                bool own = info.related_sample_identity.writer_guid() == client->hears->guid() || info.related_sample_identity.writer_guid() == client->asks->guid();
                if (own) std::cout << "{\"answer\": " << info.related_sample_identity.sequence_number().to64long() << ", \"success\": "
                                   << (r.success ? "true" : "false") << ", \"message\": " << quoted(r.message) << "}\n";
            });
        std::vector<std::string> asked;
        { std::lock_guard<std::mutex> guard(lines_lock); asked.swap(lines); }
        for (auto& line : asked) {
            if (line == "greedy") greedy = reader<Csi>("rt" + node + "/csi", in_dds("csi5300_msgs", "Csi"), true);
            else if (line == "modest") { subscriber->delete_datareader(greedy); greedy = nullptr; }
            else {
                Client& client = line == "call start_recording" ? start : stop;
                Request request;
                rtps::WriteParams params;
                params.related_sample_identity().writer_guid() = client.hears->guid();
                client.asks->write(&request, params);
                std::cout << "{\"asked\": " << params.sample_identity().sequence_number().to64long() << "}\n";
            }
        }
        std::cout.flush();
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    participant->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant);
}
