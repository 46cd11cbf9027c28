// The newest exported image, fetched when it is looked at; images of frames with maps; the mask.

import { panel } from "./stream.js";

/** Fetch an image of the server: {bitmap, size}, or null. */
async function fetched(path) {
  const reply = await fetch(path).catch(() => null);
  const size = reply?.ok ? reply.headers.get("x-frame-size").split(" ").map(Number) : null;
  const bitmap = size && (await reply.blob().then(createImageBitmap).catch(() => null));
  return bitmap ? { bitmap, size } : null;
}

const images = new Map();
const MAX_IMAGES = 8;

/** The image of a frame with maps: {bitmap, size, frame}; null if it could not be fetched. */
export async function imageOf(frame) {
  if (!images.has(frame)) {
    const image = await fetched(`image/${frame}.png`);
    if (image === null) return null;
    images.set(frame, { ...image, frame });
    if (images.size > MAX_IMAGES) images.delete(images.keys().next().value);
  }
  return images.get(frame);
}

/** The mask of the run as a bitmap to lay over an image; null without one. */
export const maskOf = () => fetched("mask.png").then((mask) => mask && mask.bitmap);

/** Call `shown({bitmap, size, name})` after each new image and `refused(text)` for one that cannot be shown. */
export function newestImage(shown, refused) {
  let latest = null, done = null, busy = false, bitmap = null;

  async function fetchNewest() {
    if (busy || document.hidden || !latest || latest.newest === null || latest.newest === done) return;
    busy = true;
    const export_ = latest.newest, name = latest.name;
    try {
      const reply = await fetch(`frame/${export_}.png`);
      if (reply.ok) {
        const size = reply.headers.get("x-frame-size").split(" ").map(Number);
        const next = await createImageBitmap(await reply.blob());
        bitmap?.close();
        bitmap = next;
        done = export_;
        shown({ bitmap, size, name });
      } else if (reply.status === 422) {
        refused((await reply.text()) || `${name} cannot be shown`);
        done = export_;
      }
    } catch { /* the connection is broken; the next message comes when it is back */ }
    busy = false;
    if (latest.newest !== export_) fetchNewest();
  }

  panel(["frames"], ({ frames }) => { latest = frames; fetchNewest(); });
  document.addEventListener("visibilitychange", fetchNewest);
}
