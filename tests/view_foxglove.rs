//! Contract: a player of the Foxglove WebSocket protocol, under either of its names, gets channels with ROS 2 schemas and the
//! messages that were published, as CDR; what this server does not do is refused with a word, and the connection stays.

mod ipc_rig;
mod view_rig;

use noctule::io::ros;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::time::{Duration, Instant};
use tungstenite::Message;
use view_rig::{LIMIT, RANGES, Served, Socket, Speakers};

const SDK: [(&str, &str); 1] = [("Sec-WebSocket-Protocol", "foxglove.sdk.v1")];
const STUDIO: [(&str, &str); 1] = [("Sec-WebSocket-Protocol", "foxglove.websocket.v1")];

fn text(socket: &mut Socket) -> Value {
    loop {
        if let Message::Text(text) = socket.read().expect("a message") {
            return serde_json::from_str(text.as_str()).expect("JSON");
        }
    }
}

fn say(socket: &mut Socket, word: &Value) {
    socket.send(Message::text(word.to_string())).expect("said");
}

/// Channels by topic, after the server's own introduction.
fn channels(socket: &mut Socket) -> BTreeMap<String, Value> {
    let info = text(socket);
    assert_eq!(info["op"], "serverInfo");
    assert_eq!(info["capabilities"], json!([]));
    assert!(info["name"].as_str().is_some_and(|name| name.starts_with("noctule")));
    let advertised = text(socket);
    assert_eq!(advertised["op"], "advertise");
    let list = advertised["channels"].as_array().expect("channels").clone();
    list.into_iter().map(|channel| (channel["topic"].as_str().expect("topic").to_owned(), channel)).collect()
}

/// The next message while the robot speaks on: one that it said before the server had heard of a subscription is not sent.
fn heard(socket: &mut Socket, speakers: &mut Speakers) -> Message {
    let begun = Instant::now();
    let patience = |socket: &Socket, limit| socket.get_ref().set_read_timeout(Some(limit)).expect("limited");
    patience(socket, Duration::from_millis(100));
    loop {
        assert!(begun.elapsed() < LIMIT, "no message");
        speakers.ping_set();
        match socket.read() {
            Err(tungstenite::Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => {}
            message => {
                patience(socket, LIMIT);
                return message.expect("a message");
            }
        }
    }
}

/// The next message of each of these subscriptions, while the robot speaks: log time and payload.
fn data(socket: &mut Socket, speakers: &mut Speakers, ids: &[u32]) -> BTreeMap<u32, (u64, Vec<u8>)> {
    let (begun, mut found) = (Instant::now(), BTreeMap::new());
    while found.len() < ids.len() {
        assert!(begun.elapsed() < LIMIT, "only {:?}", found.keys());
        if let Message::Binary(bytes) = heard(socket, speakers) {
            assert_eq!(bytes[0], 1, "message data");
            let id = u32::from_le_bytes(bytes[1..5].try_into().expect("four bytes"));
            let time = u64::from_le_bytes(bytes[5..13].try_into().expect("eight bytes"));
            assert!(ids.contains(&id), "nobody asked for {id}");
            found.insert(id, (time, bytes[13..].to_vec()));
        }
    }
    found
}

#[test]
fn a_player_gets_channels_and_the_messages_that_were_published() {
    let served = Served::new();
    let mut speakers = Speakers::new(&served.place);
    for (path, protocol) in [("/", SDK), ("/foxglove", STUDIO)] {
        let mut socket = served.socket(path, &protocol).expect("socket");
        let channels = channels(&mut socket);
        let topics = [
            "/noctule/sonar/right/energyscape",
            "/noctule/sonar/front/scan",
            "/noctule/cmd_vel",
            "/diagnostics",
            "/tf_static",
        ];
        let types = [
            "sensor_msgs/msg/Image",
            "sensor_msgs/msg/LaserScan",
            "geometry_msgs/msg/TwistStamped",
            "diagnostic_msgs/msg/DiagnosticArray",
            "tf2_msgs/msg/TFMessage",
        ];
        let mut asked = Vec::new();
        for (index, (topic, kind)) in topics.into_iter().zip(types).enumerate() {
            let channel = &channels[topic];
            assert_eq!((&channel["encoding"], &channel["schemaEncoding"]), (&"cdr".into(), &"ros2msg".into()));
            assert_eq!(channel["schemaName"], kind);
            assert!(channel["schema"].as_str().is_some_and(|schema| schema.len() > 20));
            asked.push(json!({ "id": 10 + index, "channelId": channel["id"] }));
        }
        say(&mut socket, &json!({ "op": "subscribe", "subscriptions": asked }));
        let found = data(&mut socket, &mut speakers, &[10, 11, 12, 13, 14]);

        let image: ros::Image = ros::decode(&found[&10].1).expect("image");
        assert_eq!((image.height, image.width, image.encoding.as_str()), (180, RANGES as u32, "32FC1"));
        let at = 4 * (120 * RANGES + 100);
        let peak = f32::from_le_bytes(image.data.0[at..at + 4].try_into().expect("four bytes"));
        assert_eq!(peak, 0.1);
        let stamp_ns = image.header.stamp.sec as u64 * 1_000_000_000 + u64::from(image.header.stamp.nanosec);
        assert_eq!(stamp_ns, found[&10].0, "the message's time is its stamp");

        let scan: ros::LaserScan = ros::decode(&found[&11].1).expect("scan");
        assert_eq!((scan.ranges.len(), scan.header.frame_id.as_str()), (180, "sonar_front"));
        assert!((scan.ranges[120] - (0.3 + 100.0 * 0.0125)).abs() < 1e-4, "{}", scan.ranges[120]);

        let twist: ros::TwistStamped = ros::decode(&found[&12].1).expect("twist");
        assert_eq!((twist.twist.linear.x, twist.twist.angular.z), (0.2, -0.4));
        let diagnostics: ros::DiagnosticArray = ros::decode(&found[&13].1).expect("diagnostics");
        assert!(diagnostics.status[0].name.starts_with("noctule"));
        let mounts: ros::TFMessage = ros::decode(&found[&14].1).expect("transforms");
        let frames: Vec<&str> = mounts.transforms.iter().map(|mount| mount.child_frame_id.as_str()).collect();
        assert_eq!(frames, ["sonar_front", "sonar_left", "sonar_right"]);

        say(&mut socket, &json!({ "op": "unsubscribe", "subscriptionIds": [10, 11, 13, 14] }));
        say(&mut socket, &json!({ "op": "nothing" }));
        // What was under way before the word was heard may still come; then there is the refusal, and the twist alone.
        while !matches!(heard(&mut socket, &mut speakers), Message::Text(_)) {}
        data(&mut socket, &mut speakers, &[12]);
    }
}

#[test]
fn what_the_server_does_not_do_is_refused_with_a_word_and_the_connection_stays() {
    let served = Served::new();
    let mut socket = served.socket("/", &SDK).expect("socket");
    channels(&mut socket);
    for word in [
        json!({ "op": "getParameters", "parameterNames": [] }),
        json!({ "op": "setParameters", "parameters": [{ "name": "a", "value": 1 }] }),
        json!({ "op": "advertise", "channels": [{ "id": 1, "topic": "/noctule/cmd_vel", "encoding": "json", "schemaName": "" }] }),
        json!({ "op": "fetchAsset", "uri": "package://x", "requestId": 1 }),
        json!({ "op": "subscribe", "subscriptions": [{ "id": 1, "channelId": 999 }] }),
        json!({ "op": "subscribe", "subscriptions": [{ "id": -1 }] }),
        json!(7),
    ] {
        say(&mut socket, &word);
        let status = text(&mut socket);
        assert_eq!((&status["op"], &status["level"]), (&"status".into(), &1.into()), "{word}");
    }
    socket.send(Message::text("{ no JSON")).expect("said");
    assert_eq!(text(&mut socket)["op"], "status");
    // A published message, and a call of a service.
    for opcode in [1u8, 2] {
        socket.send(Message::binary(vec![opcode, 0, 0, 0, 0, 0])).expect("said");
        assert_eq!(text(&mut socket)["op"], "status");
    }
    assert_eq!(served.socket("/", &[]).err(), Some(400), "a socket without the protocol's name");
    assert_eq!(served.socket("/", &[("Sec-WebSocket-Protocol", "other.v1")]).err(), Some(400));
}
