// Reads a finished log with @mcap/core, its indexed reader, and prints one JSON object.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const require = createRequire(pathToFileURL(process.argv[2] + "/"));
const { McapIndexedReader } = require("@mcap/core");
const data = readFileSync(process.argv[3]);
const readable = {
  size: async () => BigInt(data.length),
  read: async (offset, size) => new Uint8Array(data.buffer, data.byteOffset + Number(offset), Number(size)),
};
const reader = await McapIndexedReader.Initialize({ readable });
const counts = {};
for await (const message of reader.readMessages()) {
  const topic = reader.channelsById.get(message.channelId).topic;
  counts[topic] = (counts[topic] ?? 0) + 1;
}
const metadata = [];
for await (const one of reader.readMetadata()) metadata.push(one.name);
console.log(JSON.stringify({ counts, metadata, chunks: reader.chunkIndexes.length, messages: Number(reader.statistics.messageCount) }));
