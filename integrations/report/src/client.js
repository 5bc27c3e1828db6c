// The page's side of the worker: a promise for each task.
/* global WORKER */

export function startWorker() {

	const url = URL.createObjectURL( new Blob( [ WORKER ], { type: 'text/javascript' } ) );
	const worker = new Worker( url );
	const waiting = new Map();
	let last = 0;
	worker.onmessage = ( { data: { id, result, error } } ) => {

		const { resolve, reject } = waiting.get( id );
		waiting.delete( id );
		error === undefined ? resolve( result ) : reject( new Error( error ) );

	};

	return ( task, input ) => new Promise( ( resolve, reject ) => {

		waiting.set( ++ last, { resolve, reject } );
		worker.postMessage( { id: last, task, input } );

	} );

}
