// The newest exported image, fetched when it is looked at.

import { panel } from "./stream.js";

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
