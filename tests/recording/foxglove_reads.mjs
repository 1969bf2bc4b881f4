// What Foxglove's own packages make of a recording: node foxglove_reads.mjs RUN.mcap LAYOUT.json
// One line of JSON: by topic the schema, whether Foxglove knows it and what it knows otherwise, how many messages its
// reader read, and how many its writer wrote back with other bytes; and what each path of the layout leads to.
import { parse } from "@foxglove/rosmsg";
import { ros2humble } from "@foxglove/rosmsg-msgs-common";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { open, readFile } from "node:fs/promises";

const [run, layoutFile] = process.argv.slice(2);
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(await open(run)),
  decompressHandlers: await loadDecompressHandlers(),
});

const fields = (one) =>
  JSON.stringify(one.definitions.map((f) => [f.name, f.type, f.isArray, f.arrayLength, f.isConstant, f.value]));

/** Names of the types of a schema, its own and those that it is made of, that Foxglove knows otherwise. */
function unlike(own, parsed) {
  return parsed
    .map((one) => [one.name ?? own, one])
    .filter(([name, one]) => name in ros2humble && fields(one) !== fields(ros2humble[name]))
    .map(([name]) => name);
}

const kinds = new Map();
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  const parsed = parse(new TextDecoder().decode(schema.data), { ros2: schema.encoding === "ros2msg" });
  const name = schema.name.replace("/msg/", "/");
  kinds.set(channel.id, {
    topic: channel.topic, schema: schema.name, encoding: `${schema.encoding}, ${channel.messageEncoding}`,
    known: name in ros2humble, unlike: unlike(name, parsed),
    reader: new MessageReader(parsed), writer: new MessageWriter(parsed), read: 0, differ: 0,
  });
}

const newest = {};
for await (const message of reader.readMessages()) {
  const kind = kinds.get(message.channelId);
  const value = kind.reader.readMessage(message.data);
  const again = kind.writer.writeMessage(value);
  kind.read += 1;
  kind.differ += Buffer.compare(Buffer.from(again), Buffer.from(message.data)) === 0 ? 0 : 1;
  newest[kind.topic] = value;
}

const layout = JSON.parse(await readFile(layoutFile, "utf8"));
const paths = {};
for (const [panel, config] of Object.entries(layout.configById)) {
  for (const { value: path } of panel.startsWith("Plot!") ? config.paths : []) {
    const [topic, ...rest] = path.split(".");
    const steps = rest.flatMap((step) => step.replace("]", "").split("["));
    paths[path] = typeof steps.reduce((at, step) => at?.[step], newest[topic]);
  }
}
const topics = [...kinds.values()].map(({ reader: _r, writer: _w, ...other }) => other);
console.log(JSON.stringify({ topics, paths }));
